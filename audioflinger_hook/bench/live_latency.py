"""How late live vibration is: a daemon's tap and its device recorded side by side.

The sound's monitor is recorded twice and the device's once. What the transform makes of the sound
offline, its latency taken out, is the vibration that should be felt with it; how much later the
device's monitor has it is the lag. Between the two recordings of the sound there must be none.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from audioflinger_hook.bench.lag import Envelope, Lag, LevelTrace, dropouts, growth, lag_between
from audioflinger_hook.bench.live_recording import (
    Recording,
    end,
    samplerate_of,
    server_name,
    spawn,
)
from audioflinger_hook.bench.live_report import LiveRecord, Numbers
from audioflinger_hook.bench.machine import cpu_model
from audioflinger_hook.bench.signals import PROJECT_ROOT
from audioflinger_hook.bench.soak import now
from audioflinger_hook.service.ask import ask_status
from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import Status
from audioflinger_hook.settings import Settings
from audioflinger_hook.transform import HapticTransform
from audioflinger_hook.transform.arrays import Frames
from device.errors import CushionError, LostError

WINDOW_S = 3.0
LEAD_S, TAIL_S = 2.0, 2.0
"""Recorded before and after what is measured: lines of time need both."""

READY_S = 30.0
SETTLES_S = 10.0
"""How long the delay line may take to its target; after that it is measured as it is."""

POLL_S = 1.0
ANSWER_S = 0.5
TICK_S = 0.1
READY = (DaemonState.RUNNING, DaemonState.IDLE)

Progress = Callable[[float, float], None]
"""Told the seconds done and those in all."""


@dataclass(frozen=True)
class Place:
    """Where a daemon runs: the monitors of what is heard and of what is felt.

    environment: leads programs to the sound server and to the daemon.
    """

    heard: str
    felt: str
    environment: Mapping[str, str]


class _Polls:
    """What the daemon told of itself, and when."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = environment
        self.seen: list[tuple[float, Status]] = []
        self._due_s = time.monotonic()

    def poll(self, now_s: float) -> None:
        """Ask it once a second; what it does not answer is left out."""
        if now_s < self._due_s:
            return
        self._due_s = now_s + POLL_S
        status = status_of_daemon(self._environment)
        if status is not None:
            self.seen.append((now_s, status))

    def median(self, value: Callable[[Status], float], *span_s: float) -> float | None:
        """Return the median of a figure, from one time to another or of all; None without one."""
        first_s, last_s = span_s or (-np.inf, np.inf)
        found = [value(status) for at_s, status in self.seen if first_s <= at_s < last_s]
        return float(np.median(found)) if found else None

    def rises(self, value: Callable[[Status], int]) -> int:
        """Return how much a counter rose, which may have begun anew."""
        counts = [value(status) for _, status in self.seen]
        return sum(max(0, b - a) for a, b in pairwise(counts))


def measure(
    place: Place,
    seconds: float,
    *,
    settings: Settings | None = None,
    block_frames: int | None = None,
    stimulus: str = "whatever played",
    progress: Progress | None = None,
) -> LiveRecord:
    """Return how late the vibration of a running daemon is, for so many seconds from now on.

    settings: the daemon's; block_frames, stimulus: for the record only. Takes 4 s more than
    `seconds`, at least WINDOW_S; waits in the calling thread.

    Raises
    ------
    LostError, NotFoundError
        The server, one of the monitors or a program needed is not there.
    """
    settings = settings or Settings()
    load_before, date = os.getloadavg()[0], now()
    rate = samplerate_of(place.heard, place.environment)
    felt_rate = samplerate_of(place.felt, place.environment)
    heard, again, felt = LevelTrace(rate), LevelTrace(rate), LevelTrace(felt_rate)
    wanted = Rendering(rate, settings)
    polls = _Polls(place.environment)

    def take_sound(mono: Frames) -> None:
        heard.add(mono)
        wanted.add(mono)

    with ExitStack() as stack:
        recordings = [
            stack.enter_context(closing(Recording(source, at_hz, place.environment, take)))
            for source, at_hz, take in (
                (place.heard, rate, take_sound),
                (place.felt, felt_rate, felt.add),
                (place.heard, rate, again.add),
            )
        ]
        start_s = time.monotonic() + LEAD_S
        end_s = start_s + max(seconds, WINDOW_S)
        while (now_s := time.monotonic()) < end_s + TAIL_S:
            for recording in recordings:
                recording.drain()
                if not recording.running:
                    raise LostError(f"{recording.source!r} is gone; start the server anew")
            if start_s <= now_s <= end_s:
                polls.poll(now_s)
            if progress:
                progress(max(0.0, now_s - start_s), end_s - start_s)
            time.sleep(TICK_S)
        lines = [recording.line() for recording in recordings]
    server = server_name(place.environment)

    sound, vibration = Envelope.of(heard, lines[0]), Envelope.of(wanted.trace, lines[0])
    output, copy = Envelope.of(felt, lines[1]), Envelope.of(again, lines[2])
    starts_s = start_s + WINDOW_S * np.arange(int((end_s - start_s) / WINDOW_S + 1e-9))
    spans_s = [(at_s, at_s + WINDOW_S) for at_s in starts_s.tolist()]
    lags_ms = _lags_ms(lag_between(vibration, output, *span_s) for span_s in spans_s)
    checks_ms = _lags_ms(lag_between(sound, copy, *span_s) for span_s in spans_s)
    found = np.array([lag_ms is not None for lag_ms in lags_ms])
    known_ms = np.array([lag_ms for lag_ms in lags_ms if lag_ms is not None])
    usual_ms = float(np.median(known_ms)) if known_ms.size else 0.0
    gaps, silent_s = dropouts(
        vibration, felt, lines[1], 1e-3 * usual_ms, start_s + 1e-3 * usual_ms, end_s
    )
    right_ms = [check_ms for check_ms in checks_ms if check_ms is not None]
    return LiveRecord(
        server=server,
        block_frames=block_frames,
        date=date,
        cpu=cpu_model(),
        cores=len(os.sched_getaffinity(0)),
        load_before=load_before,
        load_after=os.getloadavg()[0],
        stimulus=stimulus,
        seconds=end_s - start_s,
        window_s=WINDOW_S,
        lag_median_ms=usual_ms if known_ms.size else None,
        lag_p5_ms=float(np.percentile(known_ms, 5.0)) if known_ms.size else None,
        lag_p95_ms=float(np.percentile(known_ms, 95.0)) if known_ms.size else None,
        growth_ms=growth(starts_s[found], known_ms) if known_ms.size else None,
        dropouts=gaps,
        dropout_ms=1e3 * silent_s,
        splices=sum(len(line.jumps) for line in lines),
        check_median_ms=float(np.median(right_ms)) if right_ms else None,
        check_worst_ms=max(right_ms, key=abs, default=None),
        budget_ms=polls.median(lambda status: status.latency.total_ms),
        transform_ms=polls.median(lambda status: status.latency.transform_ms),
        target_ms=polls.median(lambda status: status.delay_line.target_ms),
        delay_ms=polls.median(lambda status: status.delay_line.delay_ms),
        ratio_ppm=polls.median(lambda status: status.delay_line.ratio_ppm),
        resyncs=polls.rises(lambda status: status.delay_line.resyncs),
        underflows=polls.rises(lambda status: status.delay_line.underflows),
        overflows=polls.rises(lambda status: status.delay_line.overflows),
        recoveries=polls.rises(lambda status: sum(status.recoveries.values())),
        lags_ms=lags_ms,
        budgets_ms=tuple(
            polls.median(lambda status: status.latency.total_ms, *span_s) for span_s in spans_s
        ),
    )


class Rendering:
    """What the transform makes of a sound, its latency taken out, as levels.

    The same as `cushion render` of it: mixed to one channel at full volume.
    """

    def __init__(self, samplerate: int, settings: Settings) -> None:
        self.trace = LevelTrace(samplerate)
        self._transform = HapticTransform(samplerate, 1, settings.parameters, form=settings.form)
        self._early = self._transform.latency_frames

    def add(self, mono: Frames) -> None:
        """Take the next (frames,) of sound."""
        vibration = self._transform.process(mono)[:, 0]
        skipped = min(self._early, vibration.size)
        self._early -= skipped
        self.trace.add(vibration[skipped:])


def _lags_ms(lags: Iterator[Lag | None]) -> Numbers:
    return tuple(None if lag is None else 1e3 * lag.seconds for lag in lags)


def status_of_daemon(environment: Mapping[str, str]) -> Status | None:
    """Return what the daemon there says of itself, None while it does not answer."""
    try:
        return ask_status(ANSWER_S, time.monotonic, environment)
    except CushionError:
        return None


@contextmanager
def running_daemon(
    device: str,
    environment: Mapping[str, str],
    folder: Path,
    *,
    block_frames: int | None = None,
    arguments: Sequence[str] = (),
) -> Iterator[None]:
    """A context in which `cushion run` of this very code plays to a device.

    folder: for its config file and what it prints; block_frames: for its streams, None for what
    it takes by itself.

    Raises
    ------
    LostError
        It does not come to play within READY_S; the message is its own.
    """
    command = [sys.executable, "-m", "audioflinger_hook", "run", "--device", device, *arguments]
    if block_frames is not None:
        config = folder / "latency.toml"
        config.write_text(f"block_frames = {block_frames}\n")
        command += ["--config", str(config)]
    path = os.pathsep.join(filter(None, (str(PROJECT_ROOT), environment.get("PYTHONPATH"))))
    printed = folder / "daemon.log"
    with printed.open("wb") as log:
        process = spawn(command, {**environment, "PYTHONPATH": path}, stderr=log.fileno())
        try:
            _wait_until_ready(process, environment, printed)
            yield
        finally:
            end(process)


def _wait_until_ready(
    process: subprocess.Popen[bytes], environment: Mapping[str, str], printed: Path
) -> None:
    """Return once it plays and has come to its delay, or has not for SETTLES_S."""
    began_s = time.monotonic()
    playing_s = np.inf
    while (now_s := time.monotonic()) < min(began_s + READY_S, playing_s + SETTLES_S):
        if process.poll() is not None:
            break
        status = status_of_daemon(environment)
        if status and status.state in READY and status.delay_line.delay_ms > 0.0:
            playing_s = min(playing_s, now_s)
            if status.delay_line.state == "locked":
                return
        time.sleep(TICK_S)
    if process.poll() is not None or playing_s == np.inf:
        said = printed.read_text("utf-8", "replace").strip().splitlines()
        raise LostError(f"the daemon does not play: {said[-1] if said else 'it says nothing'}")
