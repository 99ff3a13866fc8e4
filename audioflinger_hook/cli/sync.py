"""`cushion sync`: finds the delay between sound and vibration, by a person's answers.

This program plays clicks on the output that the daemon captures. The taps of vibration come from
the daemon, which delays the vibration by the offset of each trial.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from typing import Any

import numpy as np

from audioflinger_hook.cli.terminal import pressed_keys, warn
from audioflinger_hook.service import sync_trials
from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import Status
from audioflinger_hook.service.status_client import ask_control, ask_status
from audioflinger_hook.service.sync_trials import EARLIEST_MS, FOUND_MS, Answer, SyncTrials
from device.errors import CushionError, LostError, NotFoundError, UsageError
from device.server import PulseConnection, ServerSnapshot
from device.server.snapshot import Sink
from device.stream import PcmConfig, PlaybackStream, filter_stderr
from device.stream.pcms import Pcm, ServerDevice
from device.units import Float32Array

PCM, ROLE = "cushion_click", "test"  # with this role, the daemon captures the clicks

ANSWER_S = 4.0  # longest wait for an answer of the daemon
FELT_DBFS, FELT_WITHIN_S = -60.0, 8.0  # a click causes vibration of at least this level
STATUS_EVERY_S = 0.1
PAUSE_S, PAUSE_MORE_S = 0.3, 0.2  # before a click; the random part makes clicks unpredictable
REPEAT_S = 2.0  # a click without an answer is repeated after this time
TRIAL_S = 1.33  # duration of a simulated person's trial

# The profiles for live sound turn this short click into a strong tap of about 16 ms.
CLICK_HZ, DECAY_S, CLICK_S, LEVEL = 2_000.0, 0.004, 0.04, 0.25
BEGINS_S = 5.0  # longest time until a new stream plays

KEYS = {  # beginnings of what the terminal sends, in lower case
    Answer.FELT_FIRST: ("f", "\x1b[d", "\x1bod"),
    Answer.HEARD_FIRST: ("h", "\x1b[c", "\x1boc"),
    Answer.TOGETHER: ("t", " "),
}
HELP = """\
{sink} plays clicks, and each click causes a tap of vibration. Stop all other sound.
Which comes first, click or tap? Answer with these keys:
    left arrow, or f   the tap is felt first
    right arrow, or h  the click is heard first
    space, or t        both come together
The test takes about a minute. Ctrl+C ends it, and stores nothing."""

Keys = Callable[[float], str]
Say = Callable[..., None]


class Clicks:
    """Plays a click whenever `play` is called, while its stream is open."""

    def __init__(self, samplerate: int) -> None:
        time_s = np.arange(round(CLICK_S * samplerate)) / samplerate
        wave = np.cos(2.0 * np.pi * CLICK_HZ * time_s) * np.exp(-time_s / DECAY_S)
        self._click = (LEVEL * wave).astype(np.float32)
        self._next = self._click.size  # frame of the click to play next
        self.stream: PlaybackStream | None = None

    def play(self) -> None:
        """Begin a click. LostError: the stream has ended."""
        if self.stream is None or self.stream.is_lost():
            raise LostError("the output was lost during the test; connect it, and try again")
        self._next = 0

    def fill(self, out: Float32Array, now_s: float) -> None:
        """Write the next frames to the first two channels. Only the output's thread calls it."""
        part = self._click[self._next : self._next + len(out)]
        out[: part.size, :2] = part[:, None]
        self._next += part.size


@contextmanager
def open_clicks(sink: Sink, pcm: Pcm) -> Iterator[Clicks]:
    """Open a stream for clicks on a sink. LostError: it does not play within BEGINS_S."""
    pcm.target = ServerDevice(sink.name)
    clicks = Clicks(sink.samplerate)
    stream = clicks.stream = PlaybackStream(pcm, sink.samplerate, sink.channels, clicks.fill)
    with closing(stream):
        stream.audible = True
        end_s = time.monotonic() + BEGINS_S
        while stream.callbacks < 2:
            if time.monotonic() > end_s:
                raise LostError(f"{sink.name} does not play after {BEGINS_S:g} s; check the output")
            time.sleep(0.01)
        yield clicks


def run(options: argparse.Namespace) -> int:
    """Run the trials with a person or a simulated person; print and store the delay."""
    if options.seed is not None and options.seed < 0:
        raise UsageError(f"seed={options.seed} is out of range; allowed: 0 or more")
    random = np.random.default_rng(options.seed)
    if options.simulate is not None:
        person = _simulated(options.simulate, random)
        trials, seconds = _ask_simulated(person)
        given = {"delay_ms": person.delay_ms, "scatter_ms": person.scatter_ms}
        report: dict[str, Any] = {"simulated": given, "stored": False, "heard": None}
    else:
        if not (sys.stdin and sys.stdin.isatty()):
            raise UsageError(
                "sync asks questions, but its input is not a terminal; run it in a terminal, or "
                "try it with --simulate"
            )
        say = partial(print, file=sys.stderr if options.json else sys.stdout, flush=True)
        trials, seconds, heard = _ask_person(random, say)
        report = {"simulated": None, "stored": True, "heard": heard}
    found = trials.estimate()
    if options.json:
        shown = {
            "delay_ms": round(found.delay_ms, 1),
            "low_ms": round(found.low_ms, 1),
            "high_ms": round(found.high_ms, 1),
            "credible": sync_trials.CREDIBLE,
            "clipped": found.is_clipped,
            "trials": trials.count,
            "duration_s": round(seconds, 1),
        }
        print(json.dumps(shown | report))
    else:
        _tell(found, trials.count, report["heard"])
    return 0


def _tell(found: sync_trials.Estimate, count: int, heard: str | None) -> None:
    between = f"{100.0 * sync_trials.CREDIBLE:.0f} %: {found.low_ms:.0f} to {found.high_ms:.0f} ms"
    print(f"The vibration needs an offset of {found.delay_ms:.0f} ms ({between}; {count} answers).")
    if found.is_clipped:
        print(
            "The estimate is below 0, so the offset is 0, and the vibration may come after its "
            "sound. Drop-in mode can delay the sound."
        )
    if heard is not None:
        print(f'The offset is stored for {heard} and this device; offset_ms = "auto" uses it.')


def _checked(trials: SyncTrials) -> sync_trials.Estimate:
    """Return the estimate. UsageError: the answers do not agree, or the delay is too long."""
    found = trials.estimate()
    if found.width_ms > sync_trials.WIDE_MS:
        raise UsageError(
            f"{trials.count} answers leave the delay between {found.low_ms:.0f} and "
            f"{found.high_ms:.0f} ms, so nothing was stored; run `cushion sync` again, and answer "
            "each click"
        )
    if not found.is_usable:
        raise UsageError(
            f"the delay is {found.low_ms:.0f} ms or more, and this test finds delays up to "
            f"{FOUND_MS:g} ms, so nothing was stored; set offset_ms in the config"
        )
    return found


def _simulated(text: str, random: np.random.Generator) -> sync_trials.SimulatedPerson:
    """Parse MS[:SCATTER_MS]. UsageError: a value is not a number, or is out of range."""
    with suppress(ValueError):
        delay, colon, scatter = text.partition(":")
        delay_ms, scatter_ms = float(delay), float(scatter) if colon else 15.0
        if EARLIEST_MS <= delay_ms <= FOUND_MS and 1.0 <= scatter_ms <= 100.0:
            return sync_trials.SimulatedPerson(delay_ms, scatter_ms, random)
    allowed = f"MS {EARLIEST_MS:g} to {FOUND_MS:g}, SCATTER_MS 1 to 100"
    raise UsageError(f"simulate={text!r} is not MS[:SCATTER_MS]; allowed: {allowed}")


def _ask_simulated(person: sync_trials.SimulatedPerson) -> tuple[SyncTrials, float]:
    trials, now_s = SyncTrials(0.0), 0.0
    while not trials.is_over(now_s + TRIAL_S):
        offset_ms = trials.next_ms()
        trials.add(offset_ms, person.answer(offset_ms))
        now_s += TRIAL_S
    _checked(trials)
    return trials, now_s


def _ask_person(random: np.random.Generator, say: Say) -> tuple[SyncTrials, float, str]:
    """Return the trials, their duration in seconds, and the name of the sink that was heard.

    The delay is then stored. KeyboardInterrupt: nothing is stored.
    """
    status = _ready_status()
    filter_stderr()
    with ExitStack() as stack:
        pcms = stack.enter_context(closing(PcmConfig(PCM, role=ROLE)))
        connection = stack.enter_context(closing(PulseConnection()))
        sink = heard_sink(status, connection.latest)
        stack.callback(_end_trial)
        _sync(try_ms=0.0)
        clicks = stack.enter_context(open_clicks(sink, pcms.pcms[PCM]))
        keys = stack.enter_context(pressed_keys())
        _wait_vibration(clicks, sink.name)
        say(HELP.format(sink=sink.description or sink.name))
        say("Press a key to begin. Until then, the click is repeated.")
        while not keys(REPEAT_S):
            clicks.play()
        began_s = time.monotonic()
        trials = SyncTrials(began_s)
        while not trials.is_over(time.monotonic()):
            offset_ms = trials.next_ms()
            _sync(try_ms=offset_ms)
            time.sleep(PAUSE_S + PAUSE_MORE_S * random.random())
            while keys(0.0):  # pressed before the click
                pass
            say(f"click {trials.count + 1}: ", end="")
            answer = _answer_to(clicks, keys, trials, offset_ms)
            say(answer.value if answer else "the time is up")
            if answer:
                trials.add(offset_ms, answer)
        _sync(store_ms=round(_checked(trials).delay_ms, 1))
        if ask_status(ANSWER_S, time.monotonic).offset_reason == "set in the config":
            warn('the config sets offset_ms, so the result has no effect; set offset_ms = "auto"')
        return trials, time.monotonic() - began_s, sink.name


def _ready_status() -> Status:
    """Return the daemon's status. NotFoundError, UsageError: the daemon plays no vibration."""
    status = ask_status(ANSWER_S, time.monotonic)
    if status.state not in (DaemonState.RUNNING, DaemonState.IDLE):
        reason = f"{status.state.value}: {status.reason}" if status.reason else status.state.value
        raise NotFoundError(f"the daemon plays no vibration ({reason}); see `cushion status`")
    if status.muted:
        raise UsageError("the vibration is muted; switch it on in the live page")
    return status


def heard_sink(status: Status, snapshot: ServerSnapshot) -> Sink:
    """Return the sink that the daemon captures. UsageError: it captures no whole sink."""
    monitored = {source.name: source.monitor_of for source in snapshot.sources}
    name = monitored.get(status.tap.name or "")
    if name is None and status.tap.address == "default":
        name = snapshot.default_sink
    sink = snapshot.sink(name)
    if sink is None:
        raise UsageError(
            f"the daemon captures {status.tap.address}, where sync cannot play a click; start it "
            "with `cushion run --tap default`, or with sink:NAME as --tap"
        )
    return sink


def _sync(**asked: float | None) -> None:
    ask_control({"sync": asked}, ANSWER_S, time.monotonic)


def _end_trial() -> None:
    with suppress(CushionError):  # a daemon that has ended plays no trial
        _sync(try_ms=None)


def _wait_vibration(clicks: Clicks, heard: str) -> None:
    """Play clicks until the daemon reports vibration. NotFoundError: there is none."""
    end_s, next_s = time.monotonic() + FELT_WITHIN_S, 0.0
    while (now_s := time.monotonic()) < end_s:
        if now_s >= next_s:
            clicks.play()
            next_s = now_s + 0.5 * REPEAT_S
        time.sleep(STATUS_EVERY_S)
        if ask_status(ANSWER_S, time.monotonic).levels.vibration.peak_dbfs >= FELT_DBFS:
            return
    raise NotFoundError(
        f"clicks on {heard} cause no vibration; unmute {heard}, and check `include` and `exclude` "
        "in [applications], and the levels that `cushion status` shows"
    )


def _answer_to(clicks: Clicks, keys: Keys, trials: SyncTrials, offset_ms: float) -> Answer | None:
    """Play a click until it is answered; None if the time is up before."""
    while (left_s := trials.left_s(time.monotonic())) > 0.0:
        clicks.play()
        repeat_s = time.monotonic() + min(REPEAT_S, left_s)
        while (wait_s := repeat_s - time.monotonic()) > 0.0:
            pressed = keys(wait_s).lower()
            for answer, keys_of_answer in KEYS.items():
                if pressed.startswith(keys_of_answer):
                    return answer
        _sync(try_ms=offset_ms)  # else the daemon would end the trial
    return None
