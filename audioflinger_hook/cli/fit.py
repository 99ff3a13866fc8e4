"""`cushion fit`: measures a person's sensitivity, so that all frequencies feel equally strong."""

import argparse
import json
import math
import re
import secrets
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict
from datetime import datetime
from typing import Any

from audioflinger_hook.cli.terminal import pressed_keys
from audioflinger_hook.config import fits
from audioflinger_hook.config.fits import Fit
from audioflinger_hook.fit.curve import HZ
from audioflinger_hook.fit.session import (
    TRIALS_A_MINUTE,
    TRIALS_MOST,
    FitSession,
    FittedPerson,
    SimulatedSitter,
)
from audioflinger_hook.transform.design.strength import FIT_BOOST_DB
from audioflinger_hook.trials import session as trials
from audioflinger_hook.trials.page import PageAnswers, screen
from audioflinger_hook.trials.person import Person, TerminalAnswers
from audioflinger_hook.trials.player import DaemonPlayer, opened
from audioflinger_hook.trials.record import TrialRecord, design_digest
from audioflinger_hook.trials.simulated import people_file
from device.errors import UsageError
from device.values import counted

DRAWN_DB = range(-20, 21)  # a column of the drawing for each


def run(options: argparse.Namespace) -> int:
    """Fit, or show or undo fits."""
    if options.undo:
        restored = fits.undo(options.undo)
        print(f"{options.undo}: {'the fit before is back' if restored else 'removed'}")
        return 0
    if options.show is not None:
        names = options.show or fits.names()
        found = [fits.read(name) for name in names] or [fits.chosen("", None)]
        print(json.dumps([*map(_facts, found)], indent=2) if options.json else _table(found))
        return 0
    if options.seed is not None and options.seed < 0:
        raise UsageError(f"seed={options.seed} is out of range; allowed: 0 or more")
    if not 1.0 <= options.minutes <= 10.0:
        raise UsageError(f"minutes={options.minutes:g} is out of range; allowed: 1 to 10")
    if options.simulate and (options.page or options.device):
        raise UsageError("--simulate answers itself; leave out --page and --device")
    if not (options.simulate or options.page or (sys.stdin and sys.stdin.isatty())):
        raise UsageError(
            "fit asks questions, but its input is not a terminal; run it in a terminal, or with "
            "--page, or try it with --simulate SITTER.json"
        )
    sitter: SimulatedSitter | FittedPerson | None = None
    device, player, most = "simulated", None, int(TRIALS_A_MINUTE * options.minutes)
    with ExitStack() as stack:
        if options.simulate:
            about = f"the sitter {options.simulate}"
            sitter = fits.checked(SimulatedSitter, people_file(options.simulate), about)
        else:
            player = stack.enter_context(opened(options.device or "", time.monotonic))
            device = player.status().device.address
        name = options.name or re.sub(r"[^\w.+-]", "-", device)
        path = fits.path_of(name).with_suffix(".jsonl")
        if options.new:
            path.unlink(missing_ok=True)
        header = {"seed": secrets.randbits(32) if options.seed is None else options.seed}
        design = design_digest({"version": 1, "device": device, "sitter": repr(sitter)})
        record = stack.enter_context(TrialRecord(path, design, header=header))
        if resumed := len(record.trials):
            went_on = f"going on after {counted(resumed, 'answers')}; --new begins again"
            print(went_on, file=sys.stderr, flush=True)
        if player is not None:
            sitter = _person(options.page, player, record, stack)
        assert sitter is not None
        session = FitSession(sitter, record.header["seed"], min(TRIALS_MOST, most))
        for _ in trials.run(record, session, sitter.answer):
            pass
        posterior, refusal = session.posterior, session.refusal
        curves = (
            {f"{hz:g}": round(float(db), 2) for hz, db in sorted(zip(HZ, values, strict=True))}
            for values in (posterior.curve_db, posterior.uncertainty_db)
        )
        made, jnd_db = datetime.now().isoformat("T", "seconds"), round(posterior.jnd_db, 2)
        fit = Fit(name, device, made, len(record.trials), jnd_db, *curves)
        if not refusal:
            fits.store(fit)
        path.replace(path.with_suffix(".last.jsonl"))
        if options.json:
            found = {"accepted": not refusal, "reason": refusal, "resumed_trials": resumed}
            print(json.dumps(found | _facts(fit), indent=2))
        if refusal:
            raise UsageError(f"the answers are refused: {refusal}; an earlier fit stays; try again")
        if not options.json:
            print(_table([fit]))
            print('stored; use it with strength = "fit" in [transform] of the config')
    return 0


def _person(
    is_on_page: bool, player: DaemonPlayer, record: TrialRecord, stack: ExitStack
) -> FittedPerson:
    """Return a person at the terminal or on the page, who has chosen a level."""

    def tell(url: str) -> None:
        print(f"answer on this page: {url}", file=sys.stderr, flush=True)

    answers: PageAnswers | TerminalAnswers
    if is_on_page:
        answers = stack.enter_context(closing(PageAnswers(player.stop, tell, time.time)))
    else:
        answers = TerminalAnswers(stack.enter_context(pressed_keys()))
    stack.callback(answers.show, screen("text", "Thank you", "The comparisons are over."))
    known = record.trials[-1]["reference_dbfs"] if record.trials else None
    return FittedPerson(Person(player, answers), known)


def _facts(fit: Fit) -> dict[str, Any]:
    cut_hz = [float(hz) for hz, db in fit.curve_db.items() if db < -FIT_BOOST_DB]
    return {**asdict(fit), "cut_hz": cut_hz}


def _table(compared: Sequence[Fit]) -> str:
    """Return fits as tables, drawn with their uncertainty, and their differences from the first."""
    lines = []
    for fit in compared:
        made, known_db = fit.made.replace("T", " "), max(fit.uncertainty_db.values())
        about = f"known to {known_db:.1f} dB, decision noise {fit.jnd_db:.1f} dB"
        lines.append(f"{fit.name}: {made}, {fit.device}, {counted(fit.trials, 'trials')}, {about}")
        for hz, db in fit.curve_db.items():
            near_db = fit.uncertainty_db.get(hz, math.nan)
            marks = {0: ":", **{at: "-" for at in DRAWN_DB if abs(at - db) <= near_db}}
            drawn = "".join((marks | {round(db): "o"}).get(at, " ") for at in DRAWN_DB)
            line = f"  {float(hz):6.1f} Hz {db:+6.1f} dB ± {near_db:3.1f} |{drawn}|"
            if db < -FIT_BOOST_DB:
                line += f", cut at +{FIT_BOOST_DB:g} dB"
            if fit is not compared[0]:
                more_db = db - compared[0].curve_db.get(hz, math.nan)
                line += f", {more_db:+.1f} dB against {compared[0].name}"
            lines.append(line)
    return "\n".join(lines)
