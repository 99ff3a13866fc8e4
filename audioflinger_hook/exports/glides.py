"""Computes envelope, frequency and onsets of a vibration from its partials (sine components).

A partial is a sequence of glides. During a glide, frequency and amplitude change smoothly. A row of
numbers describes each glide, and a slot number says to which partial it belongs.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.design.synthesis import glide_shape, glide_turns
from device.units import FloatArray

CURVE_RATE_HZ = 500.0  # lowest rate of a curve
DELAY_AT_HZ = 60.0  # frequency curves are delayed by the low-pass delay at this frequency

# An onset is the steepest rise of the envelope within this time after an onset partial starts.
ONSET_REACH_S = 0.014
ONSETS_APART_S = 0.06  # an onset sooner than this after the previous onset is ignored
RISE_FROM = 0.4  # smallest rise of an onset, relative to the level after it
AUDIBLE = 0.01  # smallest rise, relative to the largest level

# Columns of recorded glides; see `GLIDE_COLUMNS`.
COLUMNS = 9
FRAME, FRAMES, CHANNEL, SLOT, START_HZ, END_HZ, START_LEVEL, END_LEVEL, START_PHASE = range(COLUMNS)


@dataclass(frozen=True)
class Onset:
    """A start or strong rise of vibration."""

    time_s: float
    hz: float


@dataclass(frozen=True)
class VibrationCurve:
    """The vibration of one channel, sampled at `rate_hz` from `start_s` on.

    amplitude: (n,) magnitude of the analytic signal, r.m.s. over 1 / `rate_hz`; full scale is 1.
    hz: (n,) mean frequency of the partials, weighted by power. It is constant in silence.
    onsets: in order of time, at least `ONSETS_APART_S` apart.
    """

    rate_hz: float
    start_s: float
    amplitude: NDArray[np.float32]
    hz: NDArray[np.float32]
    onsets: tuple[Onset, ...]

    @property
    def times_s(self) -> FloatArray:
        """The time of each sample in seconds."""
        return self.start_s + np.arange(self.amplitude.size) / self.rate_hz


def first_onset_slot(design: LiveDesign) -> int:
    """Return the lowest slot number of partials that start at an onset."""
    return 2 * (design.analysis.partials_max + design.onsets.onset_partials_max)


def rising(design: LiveDesign, rows: FloatArray) -> NDArray[np.bool_]:
    """Return for each glide whether the sum of the partials' amplitudes rises in its hop.

    The sum does not include partials that start at an onset. For these partials, and with loudness
    control, the result is False.
    """
    if not len(rows):
        return np.zeros(0, dtype=np.bool_)
    if design.loudness.loudness_scale.size:  # with loudness control, each glide lasts one tick
        return np.zeros(len(rows), dtype=np.bool_)
    of_hop = rows[:, SLOT] < first_onset_slot(design)
    rise = np.where(of_hop, rows[:, END_LEVEL] - rows[:, START_LEVEL], 0.0)
    _, hop = np.unique(rows[:, FRAME], return_inverse=True)
    return np.asarray(of_hop & (np.bincount(hop, rise)[hop] > design.synthesis.still))


def analytic(
    design: LiveDesign, rows: FloatArray, rises: NDArray[np.bool_]
) -> tuple[NDArray[np.complex128], FloatArray]:
    """Return analytic signals and frequencies in Hz, (glides, steps), of glides of equal length."""
    frames = int(rows[0, FRAMES])
    steps = frames // design.grid.decimation
    still = glide_shape(steps)
    # In a hop with rising amplitude, the final amplitude is reached before the end of the hop.
    shape = np.where(rises[:, None], design.synthesis.attack[:steps], still)
    turn, glide = glide_turns(steps, frames / design.samplerate)
    hz = rows[:, START_HZ, None]
    bend = rows[:, END_HZ, None] - hz
    start = rows[:, START_LEVEL, None]
    angle = hz * turn + bend * glide + 2.0 * np.pi * rows[:, START_PHASE, None]
    level = start + (rows[:, END_LEVEL, None] - start) * shape
    signal = np.empty(angle.shape, np.complex128)
    np.multiply(level, np.cos(angle), out=signal.real)
    np.multiply(level, np.sin(angle), out=signal.imag)
    return signal, hz + bend * still


def low_pass(
    design: LiveDesign, signal: NDArray[np.complex128], state: NDArray[np.complex128]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the signal after the live form's low-pass and any high-passes, and their new state."""
    made = design.synthesis
    if made.low_sections.size:
        return scipy.signal.sosfilt(np.array(made.low_sections), signal, zi=state)  # type: ignore[no-any-return]
    smooth, state = scipy.signal.lfilter(made.low_b, made.low_a, signal, zi=state)
    return smooth, state


def at_rest(design: LiveDesign) -> NDArray[np.complex128]:
    """Return the state of the filters of `low_pass` after silence."""
    sections = design.synthesis.low_sections
    shape = (len(sections), 2) if sections.size else (design.synthesis.low_a.size - 1,)
    return np.zeros(shape, np.complex128)


def aligned_s(design: LiveDesign, frame: float) -> float:
    """Return the time of a glide's frame, in s from the start of the sound, less the latency."""
    interpolation_frames = (design.synthesis.phases.size - 1) / 2
    return (frame + interpolation_frames - design.latency_frames) / design.samplerate


class CurveReader:
    """Computes a channel's `VibrationCurve` from glides, on one thread. gain: amplitude factor."""

    def __init__(self, design: LiveDesign, gain: float) -> None:
        self._design, self._gain = design, gain
        # Columns are samples at the oscillators' low rate, from step `_next` on. Rows: analytic
        # signal, total power of the partials, and sum of each partial's power times its frequency.
        self._sums = np.zeros((3, 0), np.complex128)
        self._next = 0
        self._state = at_rest(design)
        low_rate_hz = design.samplerate / design.grid.decimation
        self._steps = max(1, round(low_rate_hz / CURVE_RATE_HZ))
        self._rate_hz = low_rate_hz / self._steps
        self._powers: list[NDArray[np.float32]] = []
        self._hz: list[NDArray[np.float32]] = []
        self._births: list[tuple[float, float]] = []
        self._samples = 0

    def add(self, rows: FloatArray, frame: int) -> None:
        """Add glides. The calls so far must include all glides that start before `frame`."""
        design = self._design
        of_onset = rows[:, SLOT] >= first_onset_slot(design)
        born = rows[of_onset & (rows[:, START_LEVEL] == 0.0) & (rows[:, END_LEVEL] > 0.0)]
        self._births += [(row[FRAME], row[START_HZ]) for row in born.tolist()]
        if len(rows):
            rises = rising(design, rows)
            first = np.rint(rows[:, FRAME] / design.grid.decimation).astype(np.int64) - self._next
            self._reserve(int(first.max()) + design.grid.steps)
            for frames in np.unique(rows[:, FRAMES]):
                chosen = rows[:, FRAMES] == frames
                signal, hz = analytic(design, rows[chosen], rises[chosen])
                power = signal.real**2 + signal.imag**2
                added = np.stack((signal, power, power * hz), axis=1)
                for one, place in zip(added, first[chosen].tolist(), strict=True):
                    self._sums[:, place : place + one.shape[1]] += one
        samples = int(frame // (design.grid.decimation * self._steps)) - self._samples
        if samples <= 0:
            return
        self._samples += samples
        steps = samples * self._steps
        self._reserve(steps)
        taken, self._sums = self._sums[:, :steps], self._sums[:, steps:]
        self._next += steps
        signal, self._state = low_pass(design, taken[0], self._state)
        squares = (signal.real**2 + signal.imag**2).reshape(-1, self._steps).mean(axis=1)
        power, moment = taken[1:].real.reshape(2, -1, self._steps).sum(axis=2)
        silent = power <= 0.0
        hz = np.where(silent, np.nan, moment / np.where(silent, 1.0, power))
        self._powers.append((self._gain**2 * squares).astype(np.float32))
        self._hz.append(hz.astype(np.float32))

    def _reserve(self, steps: int) -> None:
        self._sums = np.pad(self._sums, ((0, 0), (0, max(0, steps - self._sums.shape[1]))))

    def curve(self, duration_s: float) -> VibrationCurve:
        """Return the curve of the vibration of the whole sound."""
        design, rate_hz = self._design, self._rate_hz
        first_s = aligned_s(design, (self._steps - 1) / 2 * design.grid.decimation)
        amplitude = np.sqrt(np.concatenate([*self._powers, np.zeros(1, np.float32)]))
        delay_s = design.synthesis.delay_s(DELAY_AT_HZ, design.samplerate)
        low_pass_s = delay_s - (design.synthesis.phases.size - 1) / 2 / design.samplerate
        late = round(low_pass_s * rate_hz)
        hz = held(np.concatenate([np.full(late + 1, np.nan, np.float32), *self._hz]))
        dropped = max(0, int(np.ceil(-first_s * rate_hz)))
        kept = min(max(1, int(duration_s * rate_hz)), max(1, amplitude.size - dropped))
        start_s = first_s + dropped / rate_hz
        part = slice(min(dropped, amplitude.size - 1), dropped + kept)
        curve = VibrationCurve(rate_hz, start_s, amplitude[part], hz[part], ())
        return replace(curve, onsets=self._onsets(curve))

    def _onsets(self, curve: VibrationCurve) -> tuple[Onset, ...]:
        """Return the strong rises of the envelope shortly after onset partials start."""
        level, found = curve.amplitude, list[Onset]()
        loudest = float(level.max(initial=0.0))
        reach = max(2, round(ONSET_REACH_S * curve.rate_hz))
        for frame, hz in sorted(self._births):
            after_s = aligned_s(self._design, frame) - curve.start_s
            place = max(1, round(after_s * curve.rate_hz))
            window = level[place - 1 : place + reach].astype(np.float64)
            if window.size < 3:
                continue
            steepest = place + int(np.diff(window).argmax())
            time_s = curve.start_s + (steepest - 0.5) / curve.rate_hz
            before = float(level[max(0, steepest - reach) : steepest].min())
            after = float(level[steepest : steepest + reach].max())
            rise = after - before
            last_s = found[-1].time_s if found else -np.inf
            strong = rise >= max(RISE_FROM * after, AUDIBLE * loudest)
            if strong and time_s > 0.0 and time_s - last_s >= ONSETS_APART_S:
                found.append(Onset(time_s, hz))
        return tuple(found)


def held(hz: NDArray[np.float32]) -> NDArray[np.float32]:
    """Replace each NaN by the frequency before it, else by the first known one, else by 100 Hz."""
    known = np.isfinite(hz)
    if not known.any():
        return np.full(hz.size, 100.0, np.float32)
    last = np.maximum.accumulate(np.where(known, np.arange(hz.size), -1))
    last[last < 0] = int(known.argmax())
    return hz[last]
