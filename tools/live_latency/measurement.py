"""Measures the latency of live vibration, from recordings of the sound and of the vibration.

Two recordings of the sound and one of the vibration are made simultaneously. The transform renders
the expected vibration from the recorded sound, without latency. The result is the delay of the
recorded vibration relative to the expected vibration. A delay between the two recordings of the
sound is an error of the measurement.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.service.status import Status
from audioflinger_hook.transform import FloatArray, Frames, HapticTransform
from device.errors import LostError
from tools.bench.machine import cpu_model
from tools.live_latency.arrival import ArrivalLine
from tools.live_latency.daemon import status_of_daemon
from tools.live_latency.lag import Envelope, Lag, LevelTrace, dropouts, growth, lag_between
from tools.live_latency.pauses import Pause, PauseWitness
from tools.live_latency.record import LiveRecord, Numbers
from tools.live_latency.recording import Recording, samplerate_of, server_name
from tools.live_latency.usage import ProcessUse
from tools.records import now

WINDOW_S = 3.0
LEAD_S, TAIL_S = 2.0, 2.0  # additional recording time in s, required by the fit of arrival times
POLL_S = 1.0
TICK_S = 0.1

Progress = Callable[[float, float], None]  # called with the completed and the total time in s


@dataclass(frozen=True)
class Place:
    """What is recorded in a measurement.

    heard: name of the monitor of the sink that plays the sound.
    felt: name of the monitor of the sink that plays the vibration.
    environment: environment variables that select the sound server and the daemon.
    """

    heard: str
    felt: str
    environment: Mapping[str, str]


class _Polls:
    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = environment
        self.seen: list[tuple[float, Status]] = []
        self.use, self.child_use = ProcessUse(), ProcessUse()
        self._due_s = time.monotonic()

    def poll(self, now_s: float) -> None:
        """Ask the daemon for its status, at most once each second; ignore missing answers."""
        if now_s < self._due_s:
            return
        self._due_s = now_s + POLL_S
        status = status_of_daemon(self._environment)
        if status is not None:
            self.seen.append((now_s, status))
            self.use.sample(status.pid, now_s)
            if status.engine_pid:
                self.child_use.sample(status.engine_pid, now_s)

    def median(self, value: Callable[[Status], float], *span_s: float) -> float | None:
        """Return a value's median over statuses between two times or all; None without a status."""
        first_s, last_s = span_s or (-np.inf, np.inf)
        found = [value(status) for at_s, status in self.seen if first_s <= at_s < last_s]
        return float(np.median(found)) if found else None

    def rises(self, value: Callable[[Status], int]) -> int:
        counts = [value(status) for _, status in self.seen]
        return sum(max(0, b - a) for a, b in pairwise(counts))


def measure(
    place: Place,
    seconds: float,
    *,
    settings: Settings,
    block_frames: int | None = None,
    quantum_frames: int | None = None,
    stimulus: str = "whatever played",
    progress: Progress | None = None,
) -> LiveRecord:
    """Measure the delay of a running daemon's vibration.

    seconds: duration of the measurement in s, at least 3; the call takes 4 s longer.
    settings: settings of the daemon.
    block_frames, quantum_frames, stimulus: information that is only stored with the results.
    progress: function to call with the completed and the total time in s.

    LostError, NotFoundError: the server, a monitor or a required program is missing.
    """
    load_before, date = os.getloadavg()[0], now()
    listened = _listen(place, max(seconds, WINDOW_S), settings, progress)
    start_s, end_s, polls = listened.start_s, listened.end_s, listened.polls

    windows = int((end_s - start_s) / WINDOW_S + 1e-9)
    starts_s = start_s + WINDOW_S * np.arange(windows, dtype=np.float64)
    spans_s = [(at_s, at_s + WINDOW_S) for at_s in starts_s.tolist()]
    lags_ms = _lags_ms(lag_between(listened.wanted, listened.felt, *span_s) for span_s in spans_s)
    checks_ms = _lags_ms(lag_between(listened.sound, listened.copy, *span_s) for span_s in spans_s)
    right_ms = [check_ms for check_ms in checks_ms if check_ms is not None]
    budgets_ms = tuple(
        polls.median(lambda status: status.latency.total_ms, *span_s) for span_s in spans_s
    )
    hidden_ms = [
        lag_ms - budget_ms if lag_ms is not None and budget_ms is not None else None
        for lag_ms, budget_ms in zip(lags_ms, budgets_ms, strict=True)
    ]
    known_ms = np.array([lag_ms for lag_ms in lags_ms if lag_ms is not None])
    usual_s = 1e-3 * float(np.median(known_ms)) if known_ms.size else 0.0
    gaps, silent_s = dropouts(
        listened.wanted, listened.trace, listened.line, usual_s, start_s + usual_s, end_s
    )
    return LiveRecord(
        server=server_name(place.environment),
        block_frames=block_frames,
        date=date,
        cpu=cpu_model(),
        cores=len(os.sched_getaffinity(0)),
        load_before=load_before,
        load_after=os.getloadavg()[0],
        stimulus=stimulus,
        seconds=end_s - start_s,
        window_s=WINDOW_S,
        lag_median_ms=1e3 * usual_s if known_ms.size else None,
        lag_p5_ms=float(np.percentile(known_ms, 5.0)) if known_ms.size else None,
        lag_p95_ms=float(np.percentile(known_ms, 95.0)) if known_ms.size else None,
        growth_ms=_growth_ms(starts_s, lags_ms),
        hidden_growth_ms=_growth_ms(starts_s, hidden_ms),
        dropouts=gaps,
        dropout_ms=1e3 * silent_s,
        splices=listened.splices,
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
        cpu_percent=polls.use.cpu_percent,
        memory_growth_kb=polls.use.memory_growth_kb,
        machine_pauses=len(listened.pauses),
        machine_pause_ms=max((1e3 * pause.seconds for pause in listened.pauses), default=0.0),
        engine=polls.seen[-1][1].engine if polls.seen else "python",
        quantum_frames=quantum_frames,
        child_cpu_percent=polls.child_use.cpu_percent,
        child_memory_growth_kb=polls.child_use.memory_growth_kb,
        lags_ms=lags_ms,
        budgets_ms=budgets_ms,
    )


@dataclass(frozen=True)
class _Listened:
    """The recordings of one measurement.

    start_s, end_s: times between which the recordings are evaluated.
    sound, copy: two recordings of the sound.
    wanted: the expected vibration.
    felt, trace, line: envelope, levels and arrival times of the recorded vibration.
    splices: number of places in all recordings where frames are missing or inserted.
    """

    start_s: float
    end_s: float
    sound: Envelope
    copy: Envelope
    wanted: Envelope
    felt: Envelope
    trace: LevelTrace
    line: ArrivalLine
    splices: int
    polls: _Polls
    pauses: tuple[Pause, ...]


def _listen(
    place: Place, seconds: float, settings: Settings, progress: Progress | None
) -> _Listened:
    rate = samplerate_of(place.heard, place.environment)
    felt_rate = samplerate_of(place.felt, place.environment)
    heard, again, felt = LevelTrace(rate), LevelTrace(rate), LevelTrace(felt_rate)
    wanted = Rendering(rate, settings)
    polls = _Polls(place.environment)

    def take_sound(mono: Frames) -> None:
        heard.add(mono)
        wanted.add(mono)

    with ExitStack() as stack:
        witness = stack.enter_context(closing(PauseWitness()))
        recordings = [
            stack.enter_context(closing(Recording(source, at_hz, place.environment, take)))
            for source, at_hz, take in (
                (place.heard, rate, take_sound),
                (place.felt, felt_rate, felt.add),
                (place.heard, rate, again.add),
            )
        ]
        start_s = time.monotonic() + LEAD_S
        end_s = start_s + seconds
        while (now_s := time.monotonic()) < end_s + TAIL_S:
            for recording in recordings:
                recording.drain()
                if not recording.running:
                    raise LostError(f"{recording.source!r} is gone; start the server again")
            if start_s <= now_s <= end_s:
                polls.poll(now_s)
            if progress:
                progress(min(max(0.0, now_s - start_s), seconds), seconds)
            time.sleep(TICK_S)
        lines = [recording.line() for recording in recordings]
        pauses = tuple(pause for pause in witness.pauses() if start_s <= pause.start_s <= end_s)
    return _Listened(
        start_s=start_s,
        end_s=end_s,
        sound=Envelope.of(heard, lines[0]),
        copy=Envelope.of(again, lines[2]),
        wanted=Envelope.of(wanted.trace, lines[0]),
        felt=Envelope.of(felt, lines[1]),
        trace=felt,
        line=lines[1],
        splices=sum(len(line.jumps) for line in lines),
        polls=polls,
        pauses=pauses,
    )


class Rendering:
    """Levels of the vibration that the transform renders from a mono sound, without latency."""

    def __init__(self, samplerate: int, settings: Settings) -> None:
        self.trace = LevelTrace(samplerate)
        self._transform = HapticTransform(samplerate, 1, settings.parameters, form=settings.form)
        self._early = self._transform.latency_frames

    def add(self, mono: Frames) -> None:
        """Add the next block of the sound, (frames,)."""
        vibration = self._transform.process(mono)[:, 0]
        skipped = min(self._early, vibration.size)
        self._early -= skipped
        self.trace.add(vibration[skipped:])


def _growth_ms(starts_s: FloatArray, values_ms: Sequence[float | None]) -> float | None:
    known = [
        (at, value) for at, value in zip(starts_s, values_ms, strict=True) if value is not None
    ]
    if len(known) < 3:
        return None
    times_s, found_ms = np.array(known).T
    return growth(times_s, found_ms)


def _lags_ms(lags: Iterator[Lag | None]) -> Numbers:
    return tuple(None if lag is None else 1e3 * lag.seconds for lag in lags)
