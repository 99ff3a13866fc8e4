"""`cushion fit`: measures a person's sensitivity, so that all frequencies feel equally strong."""

import argparse
import json
import re
import secrets
import sys
import time
from contextlib import ExitStack, closing
from dataclasses import asdict
from datetime import datetime
from typing import Any

from audioflinger_hook.cli.terminal import pressed_keys
from audioflinger_hook.config import fits
from audioflinger_hook.config.fits import Fit
from audioflinger_hook.fit.curve import named_by_hz
from audioflinger_hook.fit.session import (
    DESIGN,
    TRIALS_A_MINUTE,
    TRIALS_MOST,
    FitSession,
    Sitter,
)
from audioflinger_hook.fit.simulated import read_sitter
from audioflinger_hook.transform.design.sensitivity import FIT_BOOST_DB
from audioflinger_hook.trials.record import TrialRecord, design_digest
from device.address import parse_device
from device.errors import UsageError
from device.values import counted, nearest

DRAWN_DB = range(-20, 21)  # a column of the drawing for each
VERBS = {"list": (0, 0), "show": (0, 1), "compare": (2, 4), "undo": (1, 1)}  # names to give


def run(options: argparse.Namespace) -> int:
    """Fit, or list, show, compare or undo fits."""
    if options.words:
        return _manage(options)
    if options.seed is not None and options.seed < 0:
        raise UsageError(f"seed={options.seed} is out of range; allowed: 0 or more")
    if not 1.0 <= options.minutes <= 10.0:
        raise UsageError(f"minutes={options.minutes:g} is out of range; allowed: 1 to 10")
    most = min(TRIALS_MOST, int(TRIALS_A_MINUTE * options.minutes))
    with ExitStack() as stack:
        if options.simulate:
            if options.page:
                raise UsageError("--simulate answers itself; leave out --page")
            sitter: Sitter = read_sitter(options.simulate)
            device = str(parse_device(options.device)) if options.device else ""
            about = {"seed": options.seed, "trials": most, "sitter": repr(sitter)}
        else:
            from audioflinger_hook.trials.player import opened

            if not options.page and not (sys.stdin and sys.stdin.isatty()):
                raise UsageError(
                    "fit asks questions, but its input is not a terminal; run it in a terminal, or "
                    "with --page, or try it with --simulate SITTER.json"
                )
            player = stack.enter_context(opened(options.device or "", time.monotonic))
            device, about = player.status().device.address, {}
        name = options.name or re.sub(r"[^\w.+-]", "-", device) or "simulated"
        path = fits.path_of(name).with_suffix(".jsonl")
        if options.new:
            path.unlink(missing_ok=True)
        header = {"seed": secrets.randbits(32) if options.seed is None else options.seed}
        design = design_digest({**DESIGN, "device": device, **about})
        record = stack.enter_context(TrialRecord(path, design, header=header))
        resumed = len(record.trials)
        if resumed and not options.json:
            print(f"going on after {counted(resumed, 'answers')}; --new begins again", flush=True)
        if not options.simulate:
            sitter = _person(options, record, player, stack)
        session = FitSession(record, sitter, most)
        for count, _ in enumerate(session.run(), resumed + 1):
            known_db = session.posterior.uncertainty_db.max()
            if not options.simulate:
                known = f"{count} answers, the curve is known to {known_db:.1f} dB"
                print(f"\n{known}", file=sys.stderr, flush=True)
        return _end(options, session, name, device, resumed)


def _person(
    options: argparse.Namespace, record: TrialRecord, player: Any, stack: ExitStack
) -> Sitter:
    """Return a person at the terminal or on the page, who has chosen a level."""
    from audioflinger_hook.fit.person import FittedPerson
    from audioflinger_hook.trials.page import PageAnswers, screen
    from audioflinger_hook.trials.person import Person, TerminalAnswers

    def tell(url: str) -> None:
        print(f"answer on this page: {url}", file=sys.stderr, flush=True)

    answers: PageAnswers | TerminalAnswers
    if options.page:
        answers = stack.enter_context(closing(PageAnswers(player.stop, tell, time.time)))
    else:
        answers = TerminalAnswers(stack.enter_context(pressed_keys()))
    known = record.trials[-1]["reference_dbfs"] if record.trials else None
    stack.callback(answers.show, screen("text", "Thank you", "The comparisons are over."))
    return FittedPerson(Person(player, answers), known)


def _end(
    options: argparse.Namespace, session: FitSession, name: str, device: str, resumed: int
) -> int:
    """Store the fit if its answers can be used, and print it. UsageError: they are refused."""
    posterior, refusal, path = session.posterior, session.refusal, fits.path_of(name)
    curves = (named_by_hz(posterior.curve_db), named_by_hz(posterior.uncertainty_db))
    made, jnd_db = datetime.now().astimezone().isoformat(), round(posterior.jnd_db, 2)
    fit = Fit(name, device, made, *curves, jnd_db, tuple(session.record.trials))
    stored = None if refusal else fits.store(fit)
    record = path.with_suffix(".jsonl")
    record.replace(record.with_suffix(".last.jsonl"))
    if options.json:
        found = {"accepted": not refusal, "reason": refusal, "resumed_trials": resumed}
        print(json.dumps({**found, **_shown(fit)}, indent=2))
    if refusal:
        kept = "the earlier fit stays" if path.exists() else "nothing was stored"
        raise UsageError(f"the answers are refused: {refusal}; {kept}; run `cushion fit` again")
    if not options.json:
        print(_text(fit))
        print(f'stored as {stored}; use it with strength = "fit" in [transform] of the config')
    return 0


def _shown(fit: Fit) -> dict[str, Any]:
    cut_hz = [float(hz) for hz, db in fit.curve_db.items() if db < -FIT_BOOST_DB]
    return {**asdict(fit), "trials": len(fit.trials), "cut_hz": cut_hz}


def _line(fit: Fit) -> str:
    return f"{fit.name}: {fit.made[:16].replace('T', ' ')}, {fit.device or 'simulated'}"


def _text(*compared: Fit) -> str:
    """Return fits as tables, drawn with their uncertainty, and their differences from the first."""
    first, lines = compared[0], []
    for fit in compared:
        about = f"{counted(len(fit.trials), 'trials')}, decision noise {fit.jnd_db:.1f} dB"
        lines.append(f"{_line(fit)}, {about}")
        for hz, level_db in fit.curve_db.items():
            near_db = fit.uncertainty_db[hz]
            line = f"  {float(hz):6.1f} Hz {level_db:+6.1f} dB ± {near_db:3.1f} |"
            for db in DRAWN_DB:
                mark = "-" if abs(db - level_db) <= near_db else ":" if db == 0 else " "
                line += "o" if db == round(level_db) else mark
            line += "|"
            if level_db < -FIT_BOOST_DB:
                line += f", cut: the gain stays +{FIT_BOOST_DB:g} dB"
            if fit is not first and hz in first.curve_db:
                line += f", {level_db - first.curve_db[hz]:+.1f} dB against {first.name}"
            lines.append(line)
    return "\n".join(lines)


def _manage(options: argparse.Namespace) -> int:
    verb, *names = options.words
    if verb not in VERBS:
        allowed, guess = f"{', '.join(VERBS)}, or no word to make a fit", nearest(verb, VERBS)
        did = f"; did you mean {guess}?" if guess else ""
        raise UsageError(f"fit {verb!r} is not known; allowed: {allowed}{did}")
    least, most = VERBS[verb]
    if not least <= len(names) <= most:
        wanted = f"{least}" if least == most else f"{least} to {most}"
        raise UsageError(f"fit {verb} takes {wanted} names of fits, not {len(names)}")
    if verb == "undo":
        restored = fits.undo(names[0])
        print(f"{names[0]}: {'the fit before is back' if restored else 'removed'}")
        return 0
    found = [fits.read(name) for name in (fits.names() if verb == "list" else names)]
    if verb == "show" and not names:
        found = [fits.chosen(device=options.device)]
    if options.json:
        print(json.dumps([_shown(fit) for fit in found], indent=2))
    else:
        print(*(map(_line, found) if verb == "list" else [_text(*found)]), sep="\n")
    return 0
