"""A session: trials are balanced, none is lost or repeated; a changed design is another study."""

import json
import random
import re
import subprocess
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from audioflinger_hook.study.design import load
from audioflinger_hook.study.people import People
from audioflinger_hook.study.session import Participant, Script, session
from audioflinger_hook.study.stimuli import Stimuli
from audioflinger_hook.trials.player import NotPlayedError
from audioflinger_hook.trials.record import TrialRecord, run
from device.errors import WriteError
from tests.support.commands import call, start
from tests.support.studies import QUESTIONS, TRUTHS, changed, make_study
from tests.support.trials import PLAYED, Answers, Player, person

KILLS = 20


class Killed(BaseException):
    pass


def rows_of(path):
    return [json.loads(line) for line in path.read_text().splitlines()][1:]


def test_interrupted_anywhere_a_session_ends_with_the_rows_of_an_uninterrupted_one(tmp_path):
    design = make_study(tmp_path, *QUESTIONS)
    answer = partial(People(design, TRUTHS, 3).answer, 0)

    def go(path, stop_after):
        with TrialRecord(path, design.digest) as record:
            for done, _ in enumerate(run(record, Script(design, 0), answer), 1):
                if done == stop_after:
                    raise Killed

    go(tmp_path / "whole.jsonl", None)
    rng, ended = random.Random(1), False
    while not ended:
        try:
            go(tmp_path / "parts.jsonl", rng.randint(1, 30))
            ended = True
        except Killed:
            pass
    assert rows_of(tmp_path / "parts.jsonl") == rows_of(tmp_path / "whole.jsonl")


def write_people(tmp_path, count):
    path = tmp_path / "people.json"
    path.write_text(json.dumps({"people": count, "seed": 3, "questions": {}}))
    return path


def ends_before(process, lines, tmp_path, timeout_s=60.0):
    """Return the exit code of a process; None once there are more lines, or after a time."""
    for _ in range(round(timeout_s / 0.01)):
        try:
            return process.wait(0.01)
        except subprocess.TimeoutExpired:
            files = (tmp_path / "parts/data").glob("*.jsonl")
            if sum(path.read_bytes().count(b"\n") for path in files) > lines:
                return None
    return None


@pytest.mark.exhaustive
def test_kill_9_at_20_random_moments_loses_and_repeats_no_trial(tmp_path):
    for name in ("whole", "parts"):
        make_study(tmp_path / name, "synchrony", participants=2)
    people = write_people(tmp_path, 1)
    assert call("study", "run", tmp_path / "whole", "--simulate", people).code == 0
    slow = (
        "import os, time\n_sync = os.fsync\n"
        "os.fsync = lambda fd: (time.sleep(0.02), _sync(fd), time.sleep(0.02))\n"
    )
    rng, kills, is_running = random.Random(2), 0, True
    seen: dict[Path, list[bytes]] = {}
    while is_running:
        command = ("study", "run", tmp_path / "parts", "--simulate", people)
        with start(*command, prelude=slow) as process:
            is_running = ends_before(process, sum(map(len, seen.values())), tmp_path) is None
            if is_running:
                is_running = ends_before(process, 10**9, tmp_path, rng.uniform(0.0, 0.3)) is None
            process.kill()
        kills += is_running
        for path in (tmp_path / "parts/data").glob("*.jsonl"):
            content = path.read_bytes().rpartition(b"\n")[0].splitlines()
            assert content[: len(seen.get(path, []))] == seen.get(path, [])
            seen[path] = content
    assert kills >= KILLS
    for path in sorted((tmp_path / "whole/data").glob("*.jsonl")):
        assert rows_of(tmp_path / "parts/data" / path.name) == rows_of(path)


def test_a_full_disk_ends_the_session_with_the_last_trial_saved(tmp_path):
    design = make_study(tmp_path, "preference")

    class Full(TrialRecord):
        def append(self, trial):
            if len(self.trials) == 5:
                raise WriteError("the disk is full; 5 trials are saved")
            super().append(trial)

    with Full(tmp_path / "r.jsonl", design.digest) as record, pytest.raises(WriteError):
        list(run(record, Script(design, 0), partial(People(design, {}, 1).answer, 0)))
    assert [row["trial"] for row in rows_of(tmp_path / "r.jsonl")] == [1, 2, 3, 4, 5]


def test_who_has_finished_cannot_take_part_again_and_the_study_ends(tmp_path):
    make_study(tmp_path, "rating", participants=2)
    people = write_people(tmp_path, 2)
    assert call("study", "run", tmp_path, "--simulate", people).code == 0
    assert call("study", "run", tmp_path, "--simulate", people).code == 0  # nothing is left to do
    for command, words in (
        (("--participant", "P1"), "is of other people"),
        (("--participant", "../P1"), "letters and digits"),
        ((), "--participant CODE is missing"),
        (("--simulate", write_people(tmp_path, 1)), "is of other people"),
    ):
        done = call("study", "run", tmp_path, *command)
        assert (done.code, words in done.stderr) == (2, True), done
    for path in (tmp_path / "data").glob("*.jsonl"):
        path.write_text(re.sub('"simulated":"\\w+"', '"simulated":""', path.read_text()))
    again = call("study", "run", tmp_path, "--participant", "S001")
    assert (again.code, "has finished already" in again.stderr) == (2, True)
    more = call("study", "run", tmp_path, "--participant", "P9")
    assert (more.code, "ends after 2 participants" in more.stderr) == (2, True)


@pytest.mark.parametrize("name", ["design.toml", "x.wav"])
def test_a_design_changed_after_the_first_participant_is_refused(tmp_path, name):
    make_study(tmp_path, "rating", participants=2)
    people = write_people(tmp_path, 1)
    assert call("study", "check", tmp_path, "--no-power").code == 0
    assert call("study", "run", tmp_path, "--simulate", people).code == 0
    changed = tmp_path / name
    changed.write_bytes(changed.read_bytes() + b"# \n")
    for action in (("check", "--no-power"), ("run", "--simulate", people), ("report",)):
        done = call("study", action[0], tmp_path, *action[1:])
        assert (done.code, "another study" in done.stderr) == (2, True), done


def test_a_person_hears_again_waits_for_the_device_and_answers_each_trial_once(tmp_path):
    make_study(tmp_path, *QUESTIONS, more="block = 50")
    design = load(tmp_path)
    lost, stopped = NotPlayedError("the device was lost"), replace(PLAYED, stopped=True)
    answers, player = Answers(None, None, "again"), Player({5: lost, 9: stopped})
    with TrialRecord(tmp_path / "r.jsonl", design.digest) as record:
        who = Participant(person(player, answers), Stimuli(design), 9)
        total = len(list(run(record, Script(design, 0), who.answer, who.pause)))
        rows = record.trials
    assert [row["trial"] for row in rows] == list(range(1, total + 1))
    assert sum(row["again"] for row in rows) == 1
    assert player.waited == 2
    assert len(player.played) == 2 + 2 + sum(1 + ("condition_2" in row) for row in rows)
    assert sum(q["title"] == "Pause" for q in answers.asked) == (total - 12) // 50
    kinds = {q["kind"] for q in answers.asked if q["choices"] or q["kind"] == "slider"}
    assert kinds == {"choice", "slider", "one of", "text"}
    assert all(len(row["vibration_sha256_1"]) == 64 for row in rows)


def conditions(row):
    return tuple(row[key] for key in ("condition_1", "condition_2") if key in row)


@pytest.mark.parametrize("participant", range(4))
@pytest.mark.parametrize("repeats", [2, 4, 6, 10])
@pytest.mark.parametrize("paradigm", ["preference", "synchrony", "threshold", "equal"])
def test_each_condition_is_first_in_half_and_each_answer_left_in_half_of_the_trials(
    tmp_path, paradigm, repeats, participant
):
    design = changed(make_study(tmp_path, paradigm), paradigm, repeats=repeats)
    question = design.questions[paradigm]
    trials = session(design, participant)
    kinds: dict[object, list[dict[str, Any]]] = {}
    for row in trials:
        if not row["practice"]:
            key = row["stimulus"], frozenset(conditions(row)), row["varied"]
            kinds.setdefault(key, []).append(row)
    assert len(kinds) == len(question.pairs) * 2 * len(question.delays)
    for of_kind in kinds.values():
        assert len(of_kind) == repeats
        left = Counter(row["choices"][0] for row in of_kind)
        assert list(left.values()) == [repeats / 2] * 2
        if len(conditions(of_kind[0])) == 2:
            first = Counter(row["condition_1"] for row in of_kind)
            assert list(first.values()) == [repeats / 2] * 2
            if repeats % 4 == 0:
                both = Counter((row["condition_1"], row["choices"][0]) for row in of_kind)
                assert list(both.values()) == [repeats / 4] * 4


def test_sessions_differ_between_participants_and_are_the_same_each_time(tmp_path):
    design = make_study(tmp_path, *QUESTIONS)
    sessions = [session(design, participant) for participant in (0, 1, 6, 0)]
    assert sessions[0] == sessions[3]
    orders = [[(r["question"], r["stimulus"], conditions(r)) for r in one] for one in sessions[:3]]
    assert orders[0] != orders[1]
    assert orders[0] != orders[2]
    assert [row["trial"] for row in sessions[1]] == list(range(1, len(sessions[1]) + 1))
    first = [session(design, k)[0]["question"] for k in range(len(QUESTIONS))]
    assert sorted(first) == sorted(QUESTIONS)  # each question comes first equally often


def test_ratings_hide_the_reference_and_the_anchor_among_the_conditions(tmp_path):
    trials = session(make_study(tmp_path, "rating", more="practice = 0"), 0)
    assert Counter(map(conditions, trials)) == {("a", name): 4 for name in "abc"}
