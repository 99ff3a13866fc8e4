"""`cushion study`: designs, runs and reports studies with people."""

import argparse
import json
import math
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from audioflinger_hook import __version__
from audioflinger_hook.cli.terminal import complain, progress_bar, warn
from audioflinger_hook.config.toml_text import listed
from audioflinger_hook.scenes.chord import chord
from audioflinger_hook.scenes.engine import engine
from audioflinger_hook.scenes.impacts import explosion
from audioflinger_hook.scenes.speech import speech
from audioflinger_hook.study import records
from audioflinger_hook.study.design import DESIGN, Design
from audioflinger_hook.study.design_check import check, load
from audioflinger_hook.study.people import People, load_people
from audioflinger_hook.study.power import power
from audioflinger_hook.study.session import Simulated, StudyPerson
from audioflinger_hook.study.session import run as run_session
from audioflinger_hook.study.stimuli import Stimuli
from audioflinger_hook.study.trials import session
from audioflinger_hook.trials.page import PageAnswers
from audioflinger_hook.trials.person import Person
from audioflinger_hook.trials.player import DaemonPlayer
from audioflinger_hook.trials.record import TrialRecord
from device.atomic_file import write_bytes_atomically
from device.drive.exposure import ACTION_A8_M_S2
from device.errors import UsageError
from device.wav_output import WavOutput

SOUNDS = {"explosion": explosion, "speech": speech, "engine": engine, "music": chord}
RATE, PEAK = 48_000, 0.5
PREREGISTRATION, REPORT = "preregistration.json", "report.html"
PEOPLE, SIMULATED = "people.json", f"{records.DATA}/people.json"


def run(options: argparse.Namespace) -> int:
    """Carry out one of the actions."""
    actions = {"new": _new, "check": _check, "run": _run, "report": _report}
    return actions[options.action](options)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _new(options: argparse.Namespace) -> int:
    folder, built_in = options.folder, files("audioflinger_hook.study") / "built_in"
    try:
        folder.mkdir(parents=True)
        (folder / "sounds").mkdir()
    except OSError as error:
        raise UsageError(f"cannot make {folder}: {error.strerror}; name a new folder") from error
    for name, voice in SOUNDS.items():
        frames = voice(RATE, np.random.default_rng(1), PEAK)
        output = WavOutput(folder / "sounds" / f"{name}.wav", RATE, frames.shape[1])
        output.write(frames)
        output.close()
    readme = (built_in / "README.md").read_text().replace("NAME", folder.name)
    for name, text in (
        (DESIGN, (built_in / f"{options.design}.toml").read_text()),
        ("README.md", readme),
        (PEOPLE, (built_in / f"{options.design}.people.json").read_text()),
    ):
        write_bytes_atomically(folder / name, text.encode())
    print(f"{folder} has {DESIGN} and README.md; next: cushion study check {folder}")
    return 0


def _check(options: argparse.Namespace) -> int:
    design, mistakes = check(options.folder)
    told = [str(mistake) for mistake in listed(mistakes)]
    stimuli = Stimuli(design)
    told = told or stimuli.mistakes() + _effect_mistakes(design)
    if not told:
        _register(design)
    else:
        for one in told:
            complain(f"{options.folder / DESIGN}: {one}")
        return UsageError.exit_code
    for sound, lowered_db in stimuli.lowered_db.items():
        if lowered_db > 0.05:
            warn(f"{sound} is {lowered_db:.1f} dB under level_db, so that no peak is cut")
    found: dict[str, Any] = {}
    for name, question in design.questions.items():
        with progress_bar(f"power of {name}") as progress:
            found[name] = None if options.no_power else power(design, question, progress)
    minutes, trials = 60.0 * design.hours, len(session(design, 0))
    document = {"sha256": design.digest, "trials": trials, "minutes": round(minutes, 1)}
    if options.json:
        print(json.dumps({**document, "power": found}, indent=2))
        return 0
    print(
        f"{trials} trials, about {minutes:.0f} min for each of {design.study.participants} people"
    )
    for name, share in found.items():
        if share is not None:
            few = (
                "" if share >= design.study.power else f", under the wanted {design.study.power:g}"
            )
            print(f"power of {name}: {share:.2f}{few} (100 simulated studies)")
    print(f"SHA-256 of {DESIGN}: {design.digest}")
    print(f"registered in {design.folder / PREREGISTRATION}; publish this sum to preregister")
    return 0


def _effect_mistakes(design: Design) -> list[str]:
    found = []
    for question in design.questions.values():
        try:
            People(design, {question.name: question.effect or {}}, 1, 2)
        except UsageError as error:
            found.append(f"effect of {error}")
    return found


def _registered(design: Design) -> dict[str, Any] | None:
    path = design.folder / PREREGISTRATION
    if not path.exists():
        return None
    try:
        found = json.loads(path.read_text())
        return {"registered": str(found["registered"]), **found, "files": dict(found["files"])}
    except (ValueError, KeyError, TypeError, OSError):
        raise UsageError(f"{path} is damaged; restore it, or delete it to register again") from None


def _register(design: Design) -> None:
    """Store the design's sums. UsageError: people took part in another design."""
    sums = {
        str(path.relative_to(design.folder) if path.is_relative_to(design.folder) else path): (
            sha256(path.read_bytes()).hexdigest()
        )
        for path in design.files
    }
    now = {"design_sha256": design.digest, "files": sums, "version": __version__}
    before = _registered(design)
    if before and all(before[key] == now[key] for key in ("design_sha256", "files")):
        return
    if before and records.record_files(design):
        wrong = [name for name, digest in sums.items() if before["files"].get(name) != digest]
        what = wrong[0] if before["design_sha256"] == design.digest and wrong else DESIGN
        raise UsageError(
            f"{what} has changed since the first participant; restore it, or copy the folder "
            "without data and preregistration.json: a changed design is another study"
        )
    document = json.dumps({**now, "registered": _now()}, indent=2)
    write_bytes_atomically(design.folder / PREREGISTRATION, f"{document}\n".encode())


def _run(options: argparse.Namespace) -> int:
    design = load(options.folder)
    _register(design)
    stimuli = Stimuli(design)
    if mistakes := stimuli.mistakes():
        raise UsageError(mistakes[0])
    (design.folder / records.DATA).mkdir(exist_ok=True)
    if options.simulate:
        _simulate(design, stimuli, options.simulate)
    else:
        _live(design, stimuli, options.participant)
    records.write_table(design, records.participants(design))
    return 0


def _simulate(design: Design, stimuli: Stimuli, file: Path) -> None:
    """Let all people of a file take part who have not finished."""
    people, content, kept = load_people(file, design), file.read_bytes(), design.folder / SIMULATED
    if kept.exists() and kept.read_bytes() != content:
        raise UsageError(f"{file} is not what the data is of; give {kept}, or move the data away")
    write_bytes_atomically(kept, content)
    finished = {one.code for one in records.participants(design) if one.is_complete}
    with progress_bar("simulated people") as progress:
        for done in range(people.count):
            progress(done, people.count)
            if (code := f"S{done + 1:03d}") not in finished:
                number, path = records.admit(design, code, True)
                with _record(design, path, code, True) as record:
                    who = Simulated(people, number, stimuli, record.trials)
                    for _ in run_session(design, number, record, who):
                        pass
    print(f"{people.count} simulated people took part; next: cushion study report {design.folder}")


def _record(design: Design, path: Path, code: str, simulated: bool) -> TrialRecord:
    header = {"participant": code, "simulated": simulated, "begun": _now()}
    return TrialRecord(path, design.digest, header=header)


def _live(design: Design, stimuli: Stimuli, code: str | None) -> None:
    """Let a person answer on the page, while the daemon plays."""
    if code is None:
        raise UsageError("--participant CODE is missing; give an anonymous code, such as P01")
    number, path = records.admit(design, code, False)
    total = len(session(design, number))
    with ExitStack() as opened:
        player = opened.enter_context(closing(DaemonPlayer(time.monotonic)))
        answers = opened.enter_context(closing(PageAnswers(player.stop, _show, time.time)))
        record = opened.enter_context(_record(design, path, code, False))
        person, before = StudyPerson(Person(player, answers), stimuli, total), len(record.trials)
        if not record.trials and not person.agrees(design.study.consent):
            raise UsageError(f"participant {code} did not agree; no trial was played")
        try:
            for _ in run_session(design, number, record, person):
                if _a8_m_s2(record.trials[before:]) > 0.5 * ACTION_A8_M_S2:
                    much = f"participant {code} has felt half of a day's exposure (action value)"
                    raise UsageError(f"{much}; go on another day, or with a lower level_db")
            person.thank()
        finally:
            if len(record.trials) < total:
                told = f"{len(record.trials)} of {total} trials are recorded; go on with"
                print(f"{told} `cushion study run {design.folder} --participant {code}`")
    print(f"participant {code} has finished")


def _a8_m_s2(rows: Sequence[Mapping[str, Any]]) -> float:
    """Return the exposure A(8) by all trials; intervals without a rig count as 0."""
    return math.hypot(*(row.get(f"a8_m_s2_{i}") or 0.0 for row in rows for i in (1, 2)))


def _show(address: str) -> None:
    print(f"the participant answers at {address}", flush=True)


def _report(options: argparse.Namespace) -> int:
    from audioflinger_hook.study import report

    design = load(options.folder)
    _register(design)
    people = records.participants(design)
    simulated = bool(people) and bool(people[0].header["simulated"])
    truths = load_people(design.folder / SIMULATED, design) if simulated else None
    found = report.results(design, people, truths)
    records.write_table(design, people)
    if options.json:
        print(json.dumps(report.as_document(found), indent=2))
        return 0
    text = report.page(design, _registered(design), people, found)
    path = options.out or design.folder / REPORT
    write_bytes_atomically(path, text.encode())
    print(f"{path} written")
    return 0
