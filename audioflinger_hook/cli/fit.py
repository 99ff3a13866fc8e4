"""`cushion fit`: measures a person's sensitivity, so that all frequencies feel equally strong."""

import argparse
import json
import secrets
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict
from datetime import datetime
from typing import Any

from audioflinger_hook.cli.terminal import pressed_keys
from audioflinger_hook.config import fits
from audioflinger_hook.config.fits import Fit
from audioflinger_hook.fit.curve import Floats, named_by_hz
from audioflinger_hook.fit.session import (
    TRIALS_A_MINUTE,
    TRIALS_MOST,
    FitSession,
    Sitter,
    design_of,
)
from audioflinger_hook.fit.simulated import read_sitter
from audioflinger_hook.transform.design.sensitivity import FIT_BOOST_DB
from audioflinger_hook.trials.record import OtherDesignError, TrialRecord
from device.address import parse_device
from device.atomic_file import write_bytes_atomically
from device.errors import UsageError, not_installed
from device.values import counted, nearest

ANSWER_S = 4.0  # longest wait for an answer of the daemon
FADED_S = 0.3  # from the end of a trial to the end of its daemon, for the fade
BEGINS_S = 20.0  # longest time until a new daemon plays
VERBS = {"list": (0, 0), "show": (0, 1), "compare": (2, 4), "undo": (1, 1)}  # names to give


def run(options: argparse.Namespace) -> int:
    """Fit, or list, show, compare or undo fits."""
    if options.words:
        return _manage(options)
    if options.seed is not None and options.seed < 0:
        raise UsageError(f"seed={options.seed} is out of range; allowed: 0 or more")
    if not 1.0 <= options.minutes <= 10.0:
        raise UsageError(f"minutes={options.minutes:g} is out of range; allowed: 1 to 10")
    trials_most = min(TRIALS_MOST, int(TRIALS_A_MINUTE * options.minutes))
    with ExitStack() as stack:
        if options.simulate:
            if options.page:
                raise UsageError("--simulate answers itself; leave out --page")
            simulated = read_sitter(options.simulate)
            device = str(parse_device(options.device)) if options.device else ""
            about = {"seed": options.seed, "trials": trials_most, "sitter": repr(simulated)}
        else:
            from audioflinger_hook.trials.player import opened

            if not options.page and not (sys.stdin and sys.stdin.isatty()):
                raise UsageError(
                    "fit asks questions, but its input is not a terminal; run it in a terminal, or "
                    "with --page, or try it with --simulate SITTER.json"
                )
            player = stack.enter_context(opened(options.device or "", time.monotonic))
            device = player.status().device.address
            about = {}
        name = options.name or fits.name_for(device)
        path = fits.path_of(name).with_suffix(".jsonl")
        if options.new:
            path.unlink(missing_ok=True)
        header = {"seed": secrets.randbits(32) if options.seed is None else options.seed}
        design = design_of(device=device, **about)
        try:
            record = TrialRecord(path, design, header=header)
        except OtherDesignError:
            if not options.simulate:
                raise
            path.unlink()
            record = TrialRecord(path, design, header=header)
        stack.enter_context(record)
        resumed = len(record.trials)
        if resumed and not options.json:
            print(f"going on after {counted(resumed, 'answers')}; --new begins again", flush=True)
        sitter = (
            simulated if options.simulate else stack.enter_context(_person(options, record, player))
        )
        session = FitSession(record, sitter, trials_most)
        session.run(_progress(options))
        return _end(options, session, name, device, resumed)


def _progress(options: argparse.Namespace) -> Callable[[int, Floats], None]:
    def show(count: int, uncertainty_db: Floats) -> None:
        if not options.simulate:
            known = f"{count} answers, the curve is known to {uncertainty_db.max():.1f} dB"
            print(f"\n{known}", file=sys.stderr, flush=True)

    return show


def _end(
    options: argparse.Namespace, session: FitSession, name: str, device: str, resumed: int
) -> int:
    """Store the fit if its answers can be used, and print it. UsageError: they are refused."""
    posterior, trials = session.posterior, session.record.trials
    fit = Fit(
        name,
        device,
        datetime.now().astimezone().isoformat(),
        named_by_hz(posterior.curve_db, reference=0.0),
        named_by_hz(posterior.uncertainty_db, reference=0.0),
        round(posterior.jnd_db, 2),
        tuple(trials),
    )
    refusal = session.refusal
    stored = None if refusal else fits.store(fit)
    record = fits.path_of(name).with_suffix(".jsonl")
    record.replace(record.with_suffix(".last.jsonl"))
    if options.json:
        shown = {
            "accepted": not refusal,
            "reason": refusal,
            **_shown(fit),
            "catch_trials": session.catches,
            "catch_wrong": session.wrong,
            "evidence": round(posterior.evidence, 2),
            "resumed_trials": resumed,
            "simulated": options.simulate is not None,
            "stored": None if stored is None else str(stored),
        }
        print(json.dumps(shown, indent=2))
    if refusal:
        kept = "the earlier fit stays" if fits.path_of(name).exists() else "nothing was stored"
        raise UsageError(f"the answers are refused: {refusal}; {kept}; run `cushion fit` again")
    if not options.json:
        print(_text(fit))
        print(f'stored as {stored}; use it with strength = "fit" in [transform] of the config')
    return 0


def _shown(fit: Fit) -> dict[str, Any]:
    cut_hz = [float(hz) for hz, db in fit.curve_db.items() if db < -FIT_BOOST_DB]
    return {**asdict(fit), "trials": len(fit.trials), "cut_hz": cut_hz}


def _text(*compared: Fit) -> str:
    """Return fits as a table, and their differences from the first."""
    first, lines = compared[0], []
    for fit in compared:
        lines.append(
            f"{fit.name}: {fit.made[:16].replace('T', ' ')}, {fit.device or 'simulated'}, "
            f"{counted(len(fit.trials), 'trials')}, decision noise {fit.jnd_db:.1f} dB"
        )
        for hz, level_db in fit.curve_db.items():
            line = f"  {float(hz):6.1f} Hz {level_db:+6.1f} dB ± {fit.uncertainty_db[hz]:.1f}"
            if level_db < -FIT_BOOST_DB:
                line += f", cut: the gain stays +{FIT_BOOST_DB:g} dB"
            if fit is not first and hz in first.curve_db:
                line += f", {level_db - first.curve_db[hz]:+.1f} dB against {first.name}"
            lines.append(line)
    return "\n".join(lines)


def _manage(options: argparse.Namespace) -> int:
    verb, *names = options.words
    if verb not in VERBS:
        guess = nearest(verb, VERBS)
        raise UsageError(
            f"fit {verb!r} is not known; allowed: {', '.join(VERBS)}, or no word to make a fit"
            + (f"; did you mean {guess}?" if guess else "")
        )
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
    if options.plot and found:
        try:
            from audioflinger_hook.fit.plot import plot_png
        except ModuleNotFoundError as error:
            raise UsageError(not_installed(str(error.name), "study")) from error
        write_bytes_atomically(options.plot, plot_png(found))
    if options.json:
        print(json.dumps([_shown(fit) for fit in found], indent=2))
    elif verb == "list":
        for fit in found:
            print(f"{fit.name}  {fit.made[:16].replace('T', ' ')}  {fit.device or 'simulated'}")
    else:
        print(_text(*found))
    return 0


@contextmanager
def _person(options: argparse.Namespace, record: TrialRecord, player: Any) -> Iterator[Sitter]:
    """Yield a person at the terminal or on the page, whose level is chosen."""
    from audioflinger_hook.fit.person import FittedPerson
    from audioflinger_hook.trials.page import PageAnswers, screen
    from audioflinger_hook.trials.person import Person, TerminalAnswers

    def tell(url: str) -> None:
        print(f"answer on this page: {url}", file=sys.stderr, flush=True)

    with ExitStack() as stack:
        answers: PageAnswers | TerminalAnswers
        if options.page:
            answers = stack.enter_context(closing(PageAnswers(player.stop, tell, time.time)))
        else:
            answers = TerminalAnswers(stack.enter_context(pressed_keys()))
        known = record.trials[-1]["reference_dbfs"] if record.trials else None
        person = FittedPerson(Person(player, answers), known)
        if known is None:
            person.choose_level()
        yield person
        answers.show(screen("text", "Thank you", "The comparisons are over."))
