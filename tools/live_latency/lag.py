"""Delay between the envelopes of two recordings, with a resolution below 1 ms.

Two runs of the live transform may analyse the sound at different frames. The waveforms of their
vibration therefore differ, while the envelopes agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft
from scipy.signal import butter, sosfiltfilt
from scipy.stats import theilslopes

from audioflinger_hook.transform import FloatArray, Frames
from tools.live_latency.arrival import ArrivalLine

STEP_S = 0.001  # interval in s of compared levels; measured levels have about this interval
ENVELOPE_HZ = 10.0
"""Cut-off of the level's smoothing, in Hz. The smoothing removes the ripple of 20 Hz vibration, and
keeps the modulation of speech.
"""

BLUR_S = 0.1  # time in s around a gap or a splice in which the smoothed level is invalid
EARLIEST_S, LATEST_S = -0.1, 1.5  # range of searched delays in s
ALIKE = 0.9  # smallest correlation of envelopes of the same sound at the best delay
GAP_S = 0.002  # shortest silence in s that counts as a gap; a zero crossing at 20 Hz is shorter
NOTHING = 1e-5  # level of silence, relative to full scale
_MERGED_S = 0.02
_ROUNDS = 12
_OUTLIER = 5.0


class LevelTrace:
    """Collects levels and silences of a recording, which is added block by block.

    samplerate: in Hz.
    step_frames: number of frames for each level.
    gaps: first frame and number of frames of each silence over 2 ms that has ended.

    Only one thread at a time may use it.
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
        """Add the next block of the recording, (frames,)."""
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
        """Return the frame number of each level, and the smoothed levels, both (steps,)."""
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

    times_s: time of each level in s, ascending, (steps,).
    level: r.m.s. of the recording, (steps,).
    usable: whether each level is valid, (steps,); False near silences and lost or inserted frames.
    """

    times_s: FloatArray
    level: FloatArray
    usable: np.ndarray[tuple[int], np.dtype[np.bool_]]

    @classmethod
    def of(cls, trace: LevelTrace, line: ArrivalLine) -> Envelope:
        """Return the envelope of a recording. line: arrival times of its frames."""
        frames, level = trace.levels()
        usable = np.ones(frames.size, dtype=bool)
        blur = BLUR_S * trace.samplerate
        spots = [(frame, 0) for frame in line.jumps] + trace.gaps
        for first, count in spots:
            usable[(frames > first - blur) & (frames < first + count + blur)] = False
        # Repeated frames would make the time run backwards.
        times_s = np.maximum.accumulate(line.times_s(frames))
        return cls(times_s, level, usable)

    def at(self, times_s: FloatArray) -> FloatArray:
        """Return the interpolated levels at the given times in s."""
        level: FloatArray = np.interp(times_s, self.times_s, self.level)
        return level

    def least(self, first_s: float, last_s: float) -> float:
        """Return the lowest level between two times in s."""
        first, beyond = np.searchsorted(self.times_s, (first_s, last_s)).tolist()
        return float(self.level[max(0, first - 1) : beyond + 1].min(initial=np.inf))

    def usable_at(self, times_s: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return for each time in s whether it is within the recording and its level is valid."""
        places = np.searchsorted(self.times_s, times_s)
        inside = (places > 0) & (places < self.times_s.size)
        places = np.clip(places, 1, self.times_s.size - 1)
        near: np.ndarray[tuple[int], np.dtype[np.bool_]] = (
            inside & self.usable[places - 1] & self.usable[places]
        )
        return near


@dataclass(frozen=True)
class Lag:
    """Delay of one envelope relative to another.

    seconds: delay in s.
    similarity: correlation of both envelopes at this delay.
    """

    seconds: float
    similarity: float


def lag_between(wanted: Envelope, heard: Envelope, start_s: float, end_s: float) -> Lag | None:
    """Return the delay of `heard` relative to the part of `wanted` from start_s to end_s.

    The first estimate is the delay from -0.1 to 1.5 s that has the largest correlation. A
    least-squares fit of delay, gain and offset then refines the estimate, without invalid levels
    and outliers. The result is None if the envelopes do not correlate, for example in silence.
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
    columns = np.column_stack((level, np.ones_like(level)))
    gains, *_ = np.linalg.lstsq(columns[kept], found[kept], rcond=None)
    fitted: FloatArray = columns @ gains
    return fitted


def growth(times_s: FloatArray, lags: FloatArray) -> float:
    """Return the change of delays from the first to the last time, on a fitted line.

    The line is fitted by the Theil-Sen estimator.
    """
    if len(lags) < 3:
        return 0.0
    every = -(-len(lags) // 1_000)  # the estimator compares all pairs
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
    """Return the number of dropouts of the vibration, and their total duration in s.

    A dropout is a silence of the vibration where the expected vibration is not silent. Dropouts
    less than 20 ms apart count as one.

    wanted: envelope of the expected vibration.
    felt: levels and silences of the recorded vibration.
    line: arrival times of the frames of the recorded vibration.
    lag_s: delay of the recorded vibration relative to the expected vibration in s.
    start_s, end_s: times in s between which dropouts are counted.
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
    """Return a tone with a randomly varying level, (frames,) float64, with a peak of 0.54.

    The level is at least a ninth of its maximum, so silence in the vibration is a dropout.

    frequency_hz: frequency, which is rounded so that the tone can be looped.
    swell_hz: highest modulation frequency.
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
