"""`cushion study`: designs, runs and reports studies with people."""

import argparse
import json
import time
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from hashlib import sha256
from os.path import relpath
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
from audioflinger_hook.study import records, report
from audioflinger_hook.study.design import BUILT_IN, DESIGN, Design, check, load
from audioflinger_hook.study.people import People, Simulated, load_people, power
from audioflinger_hook.study.session import Participant
from audioflinger_hook.study.stimuli import Stimuli
from audioflinger_hook.study.trials import Script, session
from audioflinger_hook.trials.page import PageAnswers
from audioflinger_hook.trials.person import Person
from audioflinger_hook.trials.player import opened
from audioflinger_hook.trials.record import TrialRecord
from audioflinger_hook.trials.record import run as run_session
from device.atomic_file import write_bytes_atomically
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
    folder = options.folder
    try:
        (folder / "sounds").mkdir(parents=True)
    except OSError as error:
        raise UsageError(f"cannot make {folder}: {error.strerror}; name a new folder") from error
    for name, voice in SOUNDS.items():
        frames = voice(RATE, np.random.default_rng(1), PEAK)
        with closing(WavOutput(folder / "sounds" / f"{name}.wav", RATE, frames.shape[1])) as file:
            file.write(frames)
    for name, source in {
        DESIGN: f"{options.design}.toml",
        PEOPLE: f"{options.design}.people.json",
        "README.md": "README.md",
    }.items():
        text = (BUILT_IN / source).read_text().replace("NAME", folder.name)
        write_bytes_atomically(folder / name, text.encode())
    print(f"{folder} has {DESIGN} and README.md; next: cushion study check {folder}")
    return 0


def _check(options: argparse.Namespace) -> int:
    design, mistakes = check(options.folder)
    told, stimuli = [str(mistake) for mistake in listed(mistakes)], Stimuli(design)
    if not told:
        told = stimuli.mistakes()
        for question in design.questions.values():
            try:
                People(design, {question.name: question.effect or {}}, 1, 2)
            except UsageError as error:
                told.append(f"effect of {error}")
    for one in told:
        complain(f"{options.folder / DESIGN}: {one}")
    if told:
        return UsageError.exit_code
    _register(design)
    for sound, lowered_db in stimuli.lowered_db.items():
        if lowered_db > 0.05:
            warn(f"{sound} is {lowered_db:.1f} dB under level_db, so that no peak is cut")
    found: dict[str, Any] = {}
    for name, question in design.questions.items():
        with progress_bar(f"power of {name}") as progress:
            found[name] = None if options.no_power else power(design, question, progress)
    trials, minutes = len(session(design, 0)), round(60.0 * design.hours, 1)
    if options.json:
        document = {"sha256": design.digest, "trials": trials, "minutes": minutes, "power": found}
        print(json.dumps(document, indent=2))
        return 0
    study = design.study
    print(f"{trials} trials, about {minutes:.0f} min for each of {study.participants} people")
    for name, share in found.items():
        if share is not None:
            few = "" if share >= study.power else f", under the wanted {study.power:g}"
            print(f"power of {name}: {share:.2f}{few} (100 simulated studies)")
    print(f"SHA-256 of {DESIGN}: {design.digest}")
    print(f"registered in {design.folder / PREREGISTRATION}; publish this sum to preregister")
    return 0


def _register(design: Design) -> dict[str, Any]:
    """Return the preregistration, with the design's sums, which is stored if it is new.

    UsageError: people took part in another design, or the stored file is damaged.
    """
    path = design.folder / PREREGISTRATION
    files = {relpath(file, design.folder): file for file in design.files}
    sums = {name: sha256(file.read_bytes()).hexdigest() for name, file in files.items()}
    now = {"design_sha256": design.digest, "files": sums}
    try:
        before = json.loads(path.read_text()) if path.exists() else {"files": {}}
        known = {DESIGN: before.get("design_sha256"), **before["files"]}
    except (ValueError, KeyError, TypeError, AttributeError, OSError):
        raise UsageError(f"{path} is damaged; restore it, or delete it to register again") from None
    wrong = [
        name for name, one in ({DESIGN: design.digest} | sums).items() if known.get(name) != one
    ]
    if not wrong:
        return before
    if path.exists() and records.begun(design):
        raise UsageError(
            f"{wrong[0]} has changed since the first participant; restore it, or copy the folder "
            "without data and preregistration.json: a changed design is another study"
        )
    document = {**now, "version": __version__, "registered": _now()}
    write_bytes_atomically(path, f"{json.dumps(document, indent=2)}\n".encode())
    return document


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
        _live(design, stimuli, options)
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
                    for _ in run_session(record, Script(design, number), who.answer):
                        pass
    print(f"{people.count} simulated people took part; next: cushion study report {design.folder}")


def _record(design: Design, path: Path, code: str, simulated: bool) -> TrialRecord:
    header = {"participant": code, "simulated": simulated, "begun": _now()}
    return TrialRecord(path, design.digest, header=header)


def _live(design: Design, stimuli: Stimuli, options: argparse.Namespace) -> None:
    """Let a person answer on the page, while the daemon plays."""
    if (code := options.participant) is None:
        raise UsageError("--participant CODE is missing; give an anonymous code, such as P01")
    number, path = records.admit(design, code, False)
    total = len(session(design, number))
    with ExitStack() as stack:
        player = stack.enter_context(opened(options.device or "", time.monotonic))
        answers = stack.enter_context(closing(PageAnswers(player.stop, _show, time.time)))
        record = stack.enter_context(_record(design, path, code, False))
        participant = Participant(Person(player, answers), stimuli, total)
        if not record.trials and not participant.agrees(design.study.consent):
            raise UsageError(f"participant {code} did not agree; no trial was played")
        script = Script(design, number)
        try:
            for _ in run_session(record, script, participant.answer, participant.pause):
                pass
            participant.thank()
        finally:
            if len(record.trials) < total:
                told = f"{len(record.trials)} of {total} trials are recorded; go on with"
                print(f"{told} `cushion study run {design.folder} --participant {code}`")
    print(f"participant {code} has finished")


def _show(address: str) -> None:
    print(f"the participant answers at {address}", flush=True)


def _report(options: argparse.Namespace) -> int:
    design = load(options.folder)
    registered, people = _register(design), records.participants(design)
    records.write_table(design, people)
    document = report.as_document(design, registered, people)
    if options.json:
        print(json.dumps(document, indent=2))
        return 0
    path = options.out or design.folder / REPORT
    write_bytes_atomically(path, report.page(document).encode())
    print(f"{path} written")
    return 0
