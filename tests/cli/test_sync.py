import re
from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest

from audioflinger_hook.service import sync_trials
from audioflinger_hook.service.sync_trials import SimulatedPerson
from tests.support.commands import call, document, refused
from tests.support.terminal import Terminal


@pytest.mark.parametrize("delay_ms", [30, 72.5, 180, 300])
def test_the_delay_of_a_simulated_person_is_found_in_a_minute(delay_ms):
    found = document("sync", "--simulate", f"{delay_ms}:5", "--seed", 1)
    assert found["delay_ms"] == pytest.approx(delay_ms, abs=8.0)
    assert found["low_ms"] <= found["delay_ms"] <= found["high_ms"]
    assert 8 <= found["trials"] <= 45
    assert found["duration_s"] <= 60.0
    assert found["simulated"] == {"delay_ms": delay_ms, "scatter_ms": 5.0}
    assert (found["stored"], found["heard"], found["clipped"]) == (False, None, False)


def test_the_scatter_is_15_ms_if_not_given_and_the_seed_repeats_a_person():
    found = document("sync", "--simulate", 180, "--seed", 1)
    assert found["simulated"]["scatter_ms"] == 15.0
    assert document("sync", "--simulate", "180:15", "--seed", 1) == found
    assert document("sync", "--simulate", 180, "--seed", 2) != found


def test_the_result_is_a_sentence_with_the_interval_and_the_number_of_answers():
    done = call("sync", "--simulate", "180:5", "--seed", 1)
    assert (done.code, done.stderr) == (0, "")
    assert done.stdout.startswith("The vibration needs an offset of 180 ms (95 %: 17")
    assert "answers)" in done.stdout
    assert "stored" not in done.stdout


@pytest.mark.parametrize("option", [["--simulate", "-60"], ["--simulate=-60:15"]])
def test_a_sound_before_its_vibration_gives_0_and_says_so(option):
    done = call("sync", *option, "--seed", 1)
    assert "an offset of 0 ms" in done.stdout
    assert "below 0, so the offset is 0, and the vibration may come after" in done.stdout
    found = document("sync", *option, "--seed", 1)
    assert (found["delay_ms"], found["clipped"]) == (0.0, True)


@pytest.mark.parametrize(
    "value", ["soon", "", "1:2:3", "100:", "480.1", "-101", "nan", "9:0", "9:1e9"]
)
def test_a_simulated_person_of_no_sense_is_refused_with_what_is_allowed(value):
    said = refused(call("sync", f"--simulate={value}"))
    assert repr(value) in said
    assert "allowed: MS -100 to 480, SCATTER_MS 1 to 100" in said


def test_a_negative_seed_and_answers_that_leave_the_delay_open_are_refused(monkeypatch):
    assert "seed=-1" in refused(call("sync", "--simulate", 100, "--seed", "-1"))
    guesses = partial(SimulatedPerson, lapses=1.0)
    monkeypatch.setattr("audioflinger_hook.service.sync_trials.SimulatedPerson", guesses)
    said = refused(call("sync", "--simulate", 150, "--seed", 1, "--json"))
    assert "answers leave the delay between" in said
    assert "so nothing was stored; run `cushion sync` again" in said


def test_a_delay_above_480_ms_is_refused_with_its_reason(monkeypatch):
    monkeypatch.setattr("audioflinger_hook.cli.sync.FOUND_MS", 600.0)
    for delay_ms in (495, 600):
        said = refused(call("sync", "--simulate", f"{delay_ms}:5", "--seed", 1))
        assert re.search(r"the delay is 4\d\d ms or more, .*; set offset_ms", said)


def test_without_a_terminal_it_asks_nothing():
    for options in ((), ("--json",)):
        assert "not a terminal" in refused(call("sync", *options))


def test_without_a_daemon_it_says_how_to_start_one(tmp_path):
    with Terminal("sync", env={"XDG_RUNTIME_DIR": str(tmp_path)}) as terminal:
        assert terminal.wait() == 3, terminal.shown
    assert "cushion: error: no daemon is running; start one with `cushion run`\n" in terminal.shown


TRIAL_S = 1.33  # 45 trials in a minute
PEOPLE = 100
LAPSE = {
    sync_trials.Answer.FELT_FIRST: sync_trials.Answer.HEARD_FIRST,
    sync_trials.Answer.HEARD_FIRST: sync_trials.Answer.FELT_FIRST,
}


@dataclass
class Done:
    """What came of a test; error_ms: of the delay."""

    found: sync_trials.Estimate
    error_ms: float
    seconds: float
    offsets_ms: list[float]


def done_by(delay_ms, random, *, scatter_ms=15.0, wrong=-1, **options) -> Done:
    """A test of a simulated person, whose answer number `wrong` is another than felt."""
    person = sync_trials.SimulatedPerson(delay_ms, scatter_ms, random, **options)
    trials, now_s, offsets_ms = sync_trials.SyncTrials(0.0), 0.0, []
    while not trials.is_over(now_s + TRIAL_S):
        offsets_ms.append(trials.next_ms())
        answer = person.answer(offsets_ms[-1])
        trials.add(offsets_ms[-1], LAPSE.get(answer, answer) if trials.count == wrong else answer)
        now_s += TRIAL_S
    found = trials.estimate()
    return Done(found, found.delay_ms - max(0.0, delay_ms), now_s, offsets_ms)


@pytest.fixture(scope="module")
def people():
    """A hundred tests of people who scatter by 15 ms, with 2 % lapses and windows up to 40 ms."""
    random, found = np.random.default_rng(7), []
    for _ in range(PEOPLE):
        delay_ms = random.uniform(0.0, 300.0)
        found.append((delay_ms, done_by(delay_ms, random, window_ms=random.uniform(0.0, 40.0))))
    return found


def test_a_delay_is_found_to_8_ms_in_a_minute_by_9_of_10_people(people):
    errors_ms = np.array([done.error_ms for _, done in people])
    print(f"{np.mean(np.abs(errors_ms) <= 8.0):.0%} to 8 ms, deviation {errors_ms.std():.1f} ms")
    assert np.count_nonzero(np.abs(errors_ms) <= 8.0) >= 0.9 * PEOPLE
    assert max(done.seconds for _, done in people) <= sync_trials.LONGEST_S
    assert max(len(done.offsets_ms) for _, done in people) <= 45
    assert all(done.found.is_usable for _, done in people)
    offsets_ms = np.concatenate([done.offsets_ms for _, done in people])
    # a daemon can play these
    assert 0.0 <= offsets_ms.min() <= offsets_ms.max() <= sync_trials.LONGEST_MS


def test_the_credible_interval_holds_as_often_as_it_says_and_a_test_ends_once_it_is_narrow(people):
    # 95 of 100, less two standard deviations of such a count
    held = [done.found.low_ms <= delay_ms <= done.found.high_ms for delay_ms, done in people]
    assert sum(held) >= 90
    for _, done in people:
        is_narrow = done.found.width_ms <= sync_trials.NARROW_MS
        assert is_narrow or done.seconds > sync_trials.LONGEST_S - TRIAL_S
    assert min(done.seconds for _, done in people) < 0.75 * sync_trials.LONGEST_S


@pytest.mark.parametrize("delay_ms", [sync_trials.EARLIEST_MS, -40.0])
def test_a_delay_below_0_is_clipped_to_0(delay_ms):
    done = done_by(delay_ms, np.random.default_rng(2))
    assert done.found.is_clipped
    assert done.found.delay_ms == 0.0
    assert (done.found.low_ms, done.found.high_ms) <= (0.0, sync_trials.NARROW_MS)


def test_a_long_delay_is_not_clipped_a_longer_one_not_usable_and_who_is_sure_is_done_sooner():
    done = done_by(sync_trials.FOUND_MS, np.random.default_rng(3))
    assert abs(done.error_ms) <= 8.0
    assert (done.found.is_clipped, done.found.is_usable) == (False, True)
    assert not done_by(sync_trials.LONGEST_MS + 100.0, np.random.default_rng(3)).found.is_usable
    random = np.random.default_rng(1)
    seconds = [done_by(random.uniform(50, 300), random, scatter_ms=5.0).seconds for _ in range(20)]
    assert np.median(seconds) <= 0.6 * sync_trials.LONGEST_S


@pytest.mark.parametrize("wrong", [0, 1, 2])
def test_a_wrong_answer_among_the_first_is_made_up_for(wrong):
    done = done_by(120.0, np.random.default_rng(4), scatter_ms=10.0, wrong=wrong, lapses=0.0)
    assert len(done.offsets_ms) >= sync_trials.LEAST
    assert done.found.delay_ms == pytest.approx(120.0, abs=8.0)


def test_the_answers_of_people_who_guess_are_not_usable_and_before_any_nothing_is_known():
    random = np.random.default_rng(5)
    usable = [done_by(150.0, random, lapses=1.0).found.is_usable for _ in range(20)]
    assert sum(usable) <= 1  # chance may agree with itself
    found = sync_trials.SyncTrials(0.0).estimate()
    assert found.width_ms > 0.9 * sync_trials.LONGEST_MS
    assert (found.is_clipped, found.is_usable) == (False, False)


@pytest.mark.parametrize("always", [sync_trials.Answer.TOGETHER, sync_trials.Answer.FELT_FIRST])
def test_the_same_answer_to_all_offsets_is_not_usable(always):
    trials = sync_trials.SyncTrials(0.0)
    while not trials.is_over(TRIAL_S * trials.count):
        trials.add(trials.next_ms(), always)
    assert not trials.estimate().is_usable
