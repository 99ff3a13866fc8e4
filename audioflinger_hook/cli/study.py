"""`cushion study`: designs, runs and reports studies with people."""

import argparse
import json
import time
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import soundfile

from audioflinger_hook.cli.terminal import complain, progress_bar, warn
from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.study import records, report
from audioflinger_hook.study.design import BUILT_IN, DESIGN, Design, MistakesError, load
from audioflinger_hook.study.people import load_people, power
from audioflinger_hook.study.session import Participant, Script, session
from audioflinger_hook.study.stimuli import Stimuli
from audioflinger_hook.trials.page import PageAnswers, screen
from audioflinger_hook.trials.person import NO_RIG, Person
from audioflinger_hook.trials.player import opened
from audioflinger_hook.trials.record import run as run_session
from device.atomic_file import write_bytes_atomically
from device.errors import UsageError

AGREES = ("yes", "I agree", "1"), ("no", "I do not agree", "2")
THANKS = screen("text", "The end", "This was the last question. Thank you for taking part.")


def run(options: argparse.Namespace) -> int:
    """Carry out one of the actions."""
    actions = {"new": _new, "check": _check, "run": _run, "report": _report}
    try:
        actions[options.action](options)
    except MistakesError as error:
        for mistake in error.args:
            complain(f"{options.folder / DESIGN}: {mistake}")
        return MistakesError.exit_code
    return 0


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _registered(options: argparse.Namespace, design: Design) -> dict[str, Any]:
    return records.register(design, _now(), (lambda _: None) if options.json else print)


def _new(options: argparse.Namespace) -> None:
    folder = options.folder
    try:
        (folder / "sounds").mkdir(parents=True)
    except OSError as error:
        raise UsageError(f"cannot make {folder}: {error.strerror}; name a new folder") from error
    for track in demo_scene().tracks:
        path = folder / "sounds" / f"{track.name}.wav"
        soundfile.write(path, track.frames, track.samplerate, subtype="FLOAT")
    sources = {DESIGN: f"{options.design}.toml", "people.json": f"{options.design}.people.json"}
    for name, source in (sources | {"README.md": "README.md"}).items():
        text = (BUILT_IN / source).read_text().replace("NAME", folder.name)
        write_bytes_atomically(folder / name, text.encode())
    print(f"{folder} has {DESIGN} and README.md; next: cushion study check {folder}")


def _check(options: argparse.Namespace) -> None:
    design = load(options.folder)
    Stimuli(design)  # tells its mistakes
    _registered(options, design)
    trials, minutes, found = len(session(design, 0)), round(60.0 * design.hours, 1), {}
    for name in design.questions:
        with progress_bar(f"power of {name}") as progress:
            found[name] = None if options.no_power else power(design, name, progress)
    if options.json:
        document = {"sha256": design.digest, "trials": trials, "minutes": minutes, "power": found}
        print(json.dumps(document, indent=2))
        return
    study = design.study
    print(f"{trials} trials, about {minutes:.0f} min for each of {study.participants} people")
    for name, share in found.items():
        if share is not None:
            few = "" if share >= study.power else f", under the wanted {study.power:g}"
            print(f"power of {name}: {share:.2f}{few} (100 simulated studies)")
    print(f"SHA-256 of {DESIGN}: {design.digest}")


def _run(options: argparse.Namespace) -> None:
    design = load(options.folder)
    stimuli = Stimuli(design)
    _registered(options, design)
    if options.simulate and (options.participant or options.device):
        raise UsageError("--simulate answers itself; leave out --participant and --device")
    if options.simulate:
        _simulate(design, options.simulate)
    else:
        _live(design, stimuli, options)
    records.write_table(design)


def _simulate(design: Design, file: Path) -> None:
    """Let all people of a file take part who have not finished."""
    people, count = load_people(file, design)
    digest = sha256(file.read_bytes()).hexdigest()
    finished = records.finished(design, digest)
    for code in (f"S{number:03d}" for number in range(1, count + 1)):
        if code not in finished:
            with records.admit(design, code, digest, _now()) as record:
                number = record.header["number"]
                list(run_session(record, Script(design, number), partial(people.answer, number)))
    print(f"{count} simulated people took part; next: cushion study report {design.folder}")


def _live(design: Design, stimuli: Stimuli, options: argparse.Namespace) -> None:
    """Let a person answer on the page, while the daemon plays."""
    if (code := options.participant) is None:
        raise UsageError("--participant CODE is missing; give an anonymous code, such as P01")
    tell = partial(print, "the participant answers at", flush=True)
    with ExitStack() as stack:
        record = stack.enter_context(records.admit(design, code, "", _now()))
        player = stack.enter_context(opened(options.device or "", time.monotonic))
        answers = stack.enter_context(closing(PageAnswers(player.stop, tell, time.time)))
        number = record.header["number"]
        total = len(session(design, number))
        participant = Participant(Person(player, answers), stimuli, total)
        if player.status().exposure is None:
            warn(NO_RIG)
        if record.trials:
            participant.pause()
        elif participant.read("Consent", design.study.consent, *AGREES) == "no":
            raise UsageError(f"participant {code} did not agree; no trial was played")
        script = Script(design, number)
        try:
            list(run_session(record, script, participant.answer, participant.pause))
        finally:
            if (done := len(record.trials)) < total:
                print(f"{done} of {total} trials are recorded; the same command goes on")
        answers.show(THANKS)
    print(f"participant {code} has finished")


def _report(options: argparse.Namespace) -> None:
    design = load(options.folder)
    document = report.as_document(design, _registered(options, design)["registered"])
    if options.json:
        print(json.dumps(document, indent=2))
        return
    path = options.out or design.folder / "report.html"
    write_bytes_atomically(path, report.page(document).encode())
    print(f"{path} written")
