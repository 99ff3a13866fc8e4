"""`cushion fit`: measures a person's sensitivity, so that all frequencies feel equally strong."""

import argparse
import json
import math
import secrets
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict
from datetime import datetime
from functools import partial

from audioflinger_hook.cli.terminal import pressed_keys, warn
from audioflinger_hook.config import fits
from audioflinger_hook.config.toml_text import json_object
from audioflinger_hook.fit import PROTOCOL_TEXT
from audioflinger_hook.fit.curve import HZ
from audioflinger_hook.fit.session import FitSession, FittedPerson, SimulatedSitter, Sitter
from audioflinger_hook.transform.design.strength import FIT_BOOST_DB
from audioflinger_hook.trials.page import PageAnswers, screen
from audioflinger_hook.trials.person import NO_RIG, Person, TerminalAnswers
from audioflinger_hook.trials.player import opened
from audioflinger_hook.trials.record import TrialRecord, design_digest
from audioflinger_hook.trials.record import run as answered
from device.errors import UsageError
from device.values import counted

DRAWN_DB = range(-20, 21)  # a column of the drawing for each


def run(options: argparse.Namespace) -> int:
    """Fit, or show or undo fits."""
    if options.undo:
        print(f"{options.undo}: {fits.undo(options.undo)}")
    elif options.show is not None:
        names = options.show or fits.names() or [fits.default_name(options.device)]
        found = [fits.read(name) for name in names]
        print(json.dumps([*map(asdict, found)], indent=2) if options.json else _table(found))
    else:
        with ExitStack() as stack:
            _fit(options, stack)
    return 0


def _fit(options: argparse.Namespace, stack: ExitStack) -> None:
    if options.simulate and (options.page or options.device):
        raise UsageError("--simulate answers itself; leave out --page and --device")
    if not 1.0 <= options.minutes <= 3.0 or (options.seed or 0) < 0:
        told = f"minutes={options.minutes:g} or seed={options.seed} is out of range"
        raise UsageError(f"{told}; allowed: 1 to 3 minutes, and seeds of 0 or more")
    sitter: Sitter
    if options.simulate:
        values, what = json_object(options.simulate), f"the sitter {options.simulate}"
        sitter, device = fits.checked(SimulatedSitter, values, what), None
    else:
        daemon = stack.enter_context(opened(options.device or "", time.monotonic))
        device = daemon.status().device.address
        if daemon.status().exposure is None:
            warn(NO_RIG)
    name = options.name or fits.default_name(device)
    path = fits.path_of(name).with_suffix(".jsonl")
    design = design_digest({"protocol": PROTOCOL_TEXT, "for": device or repr(sitter)})
    header = {"seed": secrets.randbits(32) if options.seed is None else options.seed}
    record = stack.enter_context(TrialRecord(path, design, header=header, fresh=options.new))
    if resumed := len(record.trials):
        told = f"going on after {counted(resumed, 'answers')}; --new begins again"
        print(told, file=sys.stderr, flush=True)
    if device:
        answers: PageAnswers | TerminalAnswers
        if options.page or not (sys.stdin and sys.stdin.isatty()):
            tell = partial(print, "answer on this page:", file=sys.stderr, flush=True)
            answers = stack.enter_context(closing(PageAnswers(daemon.stop, tell, time.time)))
        else:
            answers = TerminalAnswers(stack.enter_context(pressed_keys()))
        sitter = FittedPerson(Person(daemon, answers))
    session = FitSession(sitter, record.header["seed"], int(20 * options.minutes))
    for _ in answered(record, session, sitter.answer):
        pass
    if device:
        answers.show(screen("text", "Thank you", "The comparisons are over."))
    posterior, refusal = session.posterior, session.refusal
    curves = (
        {f"{hz:g}": round(float(db), 2) for hz, db in sorted(zip(HZ, values, strict=True))}
        for values in (posterior.curve_db, posterior.uncertainty_db)
    )
    about = device or "simulated", datetime.now().isoformat(" ", "seconds"), len(record.trials)
    fit = fits.Fit(name, *about, round(posterior.jnd_db, 2), *curves)
    if not refusal:
        fits.store(fit)
    path.replace(path.with_suffix(".last.jsonl"))
    if options.json:
        facts = {"accepted": not refusal, "reason": refusal, "resumed_trials": resumed}
        print(json.dumps(facts | asdict(fit), indent=2))
    if refusal:
        raise UsageError(f"the answers are refused: {refusal}; an earlier fit stays; try again")
    if not options.json:
        print(_table([fit]), 'use it with strength = "fit" in [transform] of the config', sep="\n")


def _table(compared: Sequence[fits.Fit]) -> str:
    """Return fits as tables, drawn with their uncertainty, and their differences from the first."""
    lines, first = [], compared[0]
    for fit in compared:
        about = f"known to {max(fit.uncertainty_db.values()):.1f} dB, noise {fit.jnd_db:.1f} dB"
        lines.append(
            f"{fit.name}: {fit.made}, {fit.device}, {counted(fit.trials, 'trials')}, {about}"
        )
        for hz, db in fit.curve_db.items():
            near_db = fit.uncertainty_db.get(hz, math.nan)
            marks = {0: ":", **{at: "-" for at in DRAWN_DB if abs(at - db) <= near_db}}
            marks[round(db)] = "o"
            drawn = "".join(marks.get(at, " ") for at in DRAWN_DB)
            line = f"  {float(hz):6.1f} Hz {db:+6.1f} dB ± {near_db:3.1f} |{drawn}|"
            if db < -FIT_BOOST_DB:
                line += f", cut at +{FIT_BOOST_DB:g} dB"
            if fit is not first:
                line += f", {db - first.curve_db.get(hz, math.nan):+.1f} dB against {first.name}"
            lines.append(line)
    return "\n".join(lines)
