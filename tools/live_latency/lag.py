"""How much later one recording swells than another, to a fraction of a millisecond.

What is compared are envelopes: the live transform begins its hops anywhere in the sound, so waves
differ from one run to the next, but levels do not. Everything here is arithmetic on arrays; any
thread may use it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft
from scipy.signal import butter, sosfiltfilt
from scipy.stats import theilslopes

from audioflinger_hook.transform import FloatArray, Frames
from tools.live_latency.arrival import ArrivalLine

STEP_S = 0.001
"""Levels are taken about so often, and compared exactly so often."""

ENVELOPE_HZ = 10.0
"""Levels are smoothed to this: without the ripple of a vibration of 20 Hz, with speech's swell."""

BLUR_S = 0.1
"""So far around a gap or a splice the smoothed level is not that of the sound."""

EARLIEST_S, LATEST_S = -0.1, 1.5
"""Lags that are looked for."""

ALIKE = 0.9
"""Envelopes that correlate less at their best lag are not of the same sound."""

GAP_S = 0.002
"""Silence for longer amid vibration is a gap: a zero crossing of 20 Hz takes less than this."""

NOTHING = 1e-5
"""Under this, of full scale, is silence."""

_MERGED_S = 0.02
_ROUNDS = 12
_OUTLIER = 5.0


class LevelTrace:
    """The power of one recording every STEP_S or so, gathered block by block, and its silences.

    samplerate: Hz. step_frames: frames to each power. gaps: (first frame, frames) of every silence
    longer than GAP_S, the one at present left out. One thread at a time.
    """

    def __init__(self, samplerate: int) -> None:
        self.samplerate = samplerate
        self.step_frames = max(1, round(samplerate * STEP_S))
        self.gaps: list[tuple[int, int]] = []
        self._powers: list[FloatArray] = []
        self._rest = np.zeros(0)
        self._frames = 0
        self._silent = 0

    def add(self, mono: Frames) -> None:
        """Take the next (frames,)."""
        self._find_gaps(mono)
        squares = np.concatenate((self._rest, np.square(mono, dtype=np.float64)))
        whole = squares.size - squares.size % self.step_frames
        self._powers.append(squares[:whole].reshape(-1, self.step_frames).mean(axis=1))
        self._rest = squares[whole:]

    def _find_gaps(self, mono: Frames) -> None:
        sounding = np.flatnonzero(np.abs(mono) > NOTHING)
        edges = np.concatenate(([-1 - self._silent], sounding))
        silent = np.diff(edges) - 1
        for place in np.flatnonzero(silent > GAP_S * self.samplerate):
            self.gaps.append((self._frames + int(edges[place]) + 1, int(silent[place])))
        self._silent = mono.size - 1 - int(edges[-1])
        self._frames += mono.size

    def levels(self) -> tuple[FloatArray, FloatArray]:
        """Return the frames at which there is a level, and the smoothed level there, (steps,)."""
        powers: FloatArray = np.concatenate([*self._powers, np.zeros(0)])
        steps = np.arange(powers.size, dtype=np.float64)
        frames: FloatArray = (steps + 0.5) * self.step_frames - 0.5
        rate = self.samplerate / self.step_frames
        if powers.size < rate:
            return frames[:0], powers[:0]
        smooth = sosfiltfilt(butter(4, ENVELOPE_HZ, fs=rate, output="sos"), powers)
        level: FloatArray = np.sqrt(np.maximum(smooth, 0.0))
        return frames, level


@dataclass(frozen=True)
class Envelope:
    """The level of a recording over time.

    times_s: (steps,) ascending, seconds of one clock; level: (steps,) r.m.s.; usable: (steps,)
    False near gaps and splices.
    """

    times_s: FloatArray
    level: FloatArray
    usable: np.ndarray[tuple[int], np.dtype[np.bool_]]

    @classmethod
    def of(cls, trace: LevelTrace, line: ArrivalLine) -> Envelope:
        """Return the envelope of a recording whose frames came along that line."""
        frames, level = trace.levels()
        usable = np.ones(frames.size, dtype=bool)
        blur = BLUR_S * trace.samplerate
        spots = [(frame, 0) for frame in line.jumps] + trace.gaps
        for first, count in spots:
            usable[(frames > first - blur) & (frames < first + count + blur)] = False
        # where frames came twice the clock would run backwards
        times_s = np.maximum.accumulate(line.times_s(frames))
        return cls(times_s, level, usable)

    def at(self, times_s: FloatArray) -> FloatArray:
        """Return the level at any times in between."""
        level: FloatArray = np.interp(times_s, self.times_s, self.level)
        return level

    def least(self, first_s: float, last_s: float) -> float:
        """Return the lowest level from one time to another."""
        first, beyond = np.searchsorted(self.times_s, (first_s, last_s)).tolist()
        return float(self.level[max(0, first - 1) : beyond + 1].min(initial=np.inf))

    def usable_at(self, times_s: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return where the level can be relied on, for times within the recording."""
        places = np.searchsorted(self.times_s, times_s)
        inside = (places > 0) & (places < self.times_s.size)
        places = np.clip(places, 1, self.times_s.size - 1)
        near: np.ndarray[tuple[int], np.dtype[np.bool_]] = (
            inside & self.usable[places - 1] & self.usable[places]
        )
        return near


@dataclass(frozen=True)
class Lag:
    """By how many seconds one envelope comes after the other, and their correlation then."""

    seconds: float
    similarity: float


def lag_between(wanted: Envelope, heard: Envelope, start_s: float, end_s: float) -> Lag | None:
    """Return the lag of `heard` behind what `wanted` does from start_s to end_s.

    The best of all lags from EARLIEST_S to LATEST_S by correlation, then a least-squares fit of
    lag, gain and offset without what is not usable and without outliers. None where the two are
    not alike, as in silence.
    """
    times_s = np.arange(start_s, end_s, STEP_S)
    usable = wanted.usable_at(times_s)
    level = wanted.at(times_s)
    if usable.sum() < 0.5 * times_s.size or not np.ptp(level[usable]):
        return None
    lag_s = _coarse(level, heard, start_s)
    kept = usable
    for turn in range(_ROUNDS):
        at_s = times_s + lag_s
        kept = usable & heard.usable_at(at_s)
        if kept.sum() < 0.5 * times_s.size:
            return None
        found = heard.at(at_s)
        slope = np.gradient(found, STEP_S)
        if turn > 1:
            apart = np.abs(found - _fitted(level, found, kept))
            kept &= apart <= _OUTLIER * max(float(np.median(apart[kept])), 1e-9)
        columns = np.column_stack((level, np.ones_like(level), -slope))[kept]
        solution, *_ = np.linalg.lstsq(columns, found[kept], rcond=None)
        lag_s += float(np.clip(solution[2], -0.02, 0.02))
    found = heard.at(times_s + lag_s)
    if not np.ptp(found[kept]) or not EARLIEST_S <= lag_s <= LATEST_S:
        return None
    similarity = float(np.corrcoef(level[kept], found[kept])[0, 1])
    return Lag(lag_s, similarity) if similarity >= ALIKE else None


def _coarse(level: FloatArray, heard: Envelope, start_s: float) -> float:
    """Return the lag of the best normalised correlation, to STEP_S."""
    lags = round((LATEST_S - EARLIEST_S) / STEP_S) + 1
    count = level.size
    reach = np.arange(lags + count - 1, dtype=np.float64)
    far = heard.at(start_s + EARLIEST_S + STEP_S * reach)
    level = level - level.mean()
    size = far.size + count
    products = irfft(rfft(far, size) * rfft(level, size).conj(), size)[:lags]
    sums = np.cumsum(np.concatenate(([0.0], far)))
    squares = np.cumsum(np.concatenate(([0.0], far**2)))
    mean = (sums[count:] - sums[:-count]) / count
    spread = (squares[count:] - squares[:-count]) / count - mean**2
    floor = 1e-6 * float(np.max(spread, initial=0.0)) + 1e-30
    best = int(np.argmax(products / np.sqrt(np.maximum(spread, floor))))
    return EARLIEST_S + STEP_S * best


def _fitted(
    level: FloatArray, found: FloatArray, kept: np.ndarray[tuple[int], np.dtype[np.bool_]]
) -> FloatArray:
    """Return `level` with the gain and offset that bring it nearest to `found`."""
    columns = np.column_stack((level, np.ones_like(level)))
    gains, *_ = np.linalg.lstsq(columns[kept], found[kept], rcond=None)
    fitted: FloatArray = columns @ gains
    return fitted


def growth(times_s: FloatArray, lags: FloatArray) -> float:
    """Return how much lags grow from the first time to the last: the Theil-Sen line's rise."""
    if len(lags) < 3:
        return 0.0
    every = -(-len(lags) // 1_000)  # it compares every two
    slope = theilslopes(lags[::every], times_s[::every]).slope
    return float(slope * (times_s[-1] - times_s[0]))


def dropouts(
    wanted: Envelope,
    felt: LevelTrace,
    line: ArrivalLine,
    lag_s: float,
    start_s: float,
    end_s: float,
) -> tuple[int, float]:
    """Return how often the vibration was silent where it should not be, and seconds of it in all.

    wanted: the envelope that the vibration should have, lag_s before it is felt; start_s, end_s:
    of the time in which it is felt. Silences within 20 ms of each other are one.
    """
    if not felt.gaps:
        return 0, 0.0
    firsts, counts = np.array(felt.gaps, dtype=np.intp).T
    begin_s, last_s = line.times_s(firsts), line.times_s(firsts + counts - 1)
    loud = 0.01 * float(np.max(wanted.level, initial=0.0)) + NOTHING
    missed = np.array(
        [
            start_s <= begin and last <= end_s and wanted.least(begin - lag_s, last - lag_s) > loud
            for begin, last in zip(begin_s.tolist(), last_s.tolist(), strict=True)
        ]
    )
    begin_s, last_s = begin_s[missed], last_s[missed]
    if not begin_s.size:
        return 0, 0.0
    apart = begin_s[1:] - last_s[:-1] > _MERGED_S
    return 1 + int(apart.sum()), float(np.sum(last_s - begin_s))


def swelling_tone(
    frequency_hz: float, duration_s: float, samplerate: int, *, swell_hz: float = 4.0, seed: int = 1
) -> FloatArray:
    """Return a tone whose level never swells the same way twice, (frames,) float64, peak 0.54.

    frequency_hz: rounded so that the end joins the start. swell_hz: the fastest swell. The level
    stays above a ninth of the highest, so that silence in its vibration is a fault.
    """
    count = round(duration_s * samplerate)
    cycles = round(frequency_hz * duration_s)
    bins = np.arange(count // 2 + 1) / duration_s
    phases = np.exp(2j * np.pi * np.random.default_rng(seed).random(bins.size))
    swell = irfft(np.where((bins >= 0.2) & (bins <= swell_hz), phases, 0.0), count)
    swell /= np.abs(swell).max()
    tone = np.sin(2.0 * np.pi * cycles * np.arange(count) / count)
    sound: FloatArray = 0.3 * (1.0 + 0.8 * swell) * tone
    return sound
