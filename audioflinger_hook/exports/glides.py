"""From recorded glides to the envelope, the frequency and the onsets of the vibration.

framework.take_glides() -> GlideReader -> VibrationCurve (one channel), PartialTrack (each partial)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import freqz, lfilter

from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.design.synthesis import glide_shape, glide_turns
from device.units import FloatArray

CURVE_RATE_HZ = 500.0
"""Rate of the curves, or a little more."""

DELAY_AT_HZ = 60.0
"""Vibration frequency whose delay all partials get."""

ONSET_REACH_S = 0.014
"""An onset is where the envelope rises most, within this time of the birth of its partials."""

ONSETS_APART_S = 0.05
"""Onsets closer than this are one."""

RISE_FROM = 0.08
"""An onset must raise the envelope by this share of its level afterwards, ..."""

AUDIBLE = 0.01
"""... and by this share of the loudest envelope."""

FRAME, FRAMES, VOICE, SLOT, START_HZ, END_HZ, START_LEVEL, END_LEVEL, START_PHASE = range(9)
"""Columns of recorded glides, see `GLIDE_COLUMNS`."""


@dataclass(frozen=True)
class Onset:
    """Where vibration begins or is struck anew.

    before, after: the envelope on both sides, in full scale; hz: of what begins.
    """

    time_s: float
    before: float
    after: float
    hz: float


@dataclass(frozen=True)
class VibrationCurve:
    """The vibration of one channel, sampled at `rate_hz` from `start_s` on.

    Attributes
    ----------
    amplitude : ndarray
        (n,) magnitude of the analytic signal, r.m.s. over a sample, full scale.
    hz : ndarray
        (n,) mean frequency, weighted by power; held where nothing vibrates.
    onsets : tuple of Onset
        In order, at least `ONSETS_APART_S` apart.
    """

    rate_hz: float
    start_s: float
    amplitude: NDArray[np.float32]
    hz: NDArray[np.float32]
    onsets: tuple[Onset, ...]

    @property
    def times_s(self) -> FloatArray:
        """Time of each sample."""
        return self.start_s + np.arange(self.amplitude.size) / self.rate_hz


class PlayedGlides:
    """How glides of one design become vibration: delay, and the low-pass at each frequency.

    design: of the transform; rate in Hz and latency are its own.
    """

    def __init__(self, design: LiveDesign) -> None:
        synthesis = design.synthesis
        self.samplerate = design.samplerate
        self.latency_frames = design.latency_frames
        self.decimation = design.grid.decimation
        self.low_rate_hz = design.samplerate / self.decimation
        self.interpolation_frames = (synthesis.phases.size - 1) / 2
        delay_s = synthesis.delay_s(DELAY_AT_HZ, design.samplerate)
        self.low_pass_s = delay_s - self.interpolation_frames / design.samplerate
        self.shift_s = delay_s - design.latency_frames / design.samplerate
        """Time of a glide in the aligned vibration, less its own time."""
        self._hz = np.arange(1.0, design.samplerate / self.decimation / 2.5, 0.25)
        _, response = freqz(synthesis.low_b, synthesis.low_a, self._hz, fs=self.low_rate_hz)
        self._gain = np.abs(response)
        self._turns = np.unwrap(np.angle(response)) / (2.0 * np.pi) + self._hz * self.low_pass_s

    def gain(self, hz: FloatArray) -> FloatArray:
        """Return what the low-pass leaves of amplitudes at these frequencies."""
        gain: FloatArray = np.interp(hz, self._hz, self._gain)
        return gain

    def turns(self, hz: FloatArray) -> FloatArray:
        """Return the phase in cycles that the low-pass adds beyond the delay of `shift_s`."""
        turns: FloatArray = np.interp(hz, self._hz, self._turns)
        return turns


class AnalyticVibration:
    """The analytic signal of one channel's glides, at the low rate of the oscillators.

    Its real part is the vibration before interpolation. Use from one thread.
    """

    def __init__(self, design: LiveDesign) -> None:
        self._synthesis, self._grid = design.synthesis, design.grid
        self._next = 0
        self._signal = np.zeros(0, np.complex128)
        self._power, self._moment = np.zeros((2, 0))
        self._state = np.zeros(design.synthesis.low_a.size - 1, np.complex128)

    def add(self, rows: FloatArray) -> None:
        """Take all rows of some whole hops and ticks of this channel."""
        if not len(rows):
            return
        grid, synthesis = self._grid, self._synthesis
        first = np.rint(rows[:, FRAME] / grid.decimation).astype(np.int64) - self._next
        self._reserve(int(first.max()) + grid.steps)
        for frames, steps, rise_shape in (
            (grid.hop_frames, grid.steps, synthesis.attack),
            (grid.tick_frames, grid.tick_steps, synthesis.tick_glide),
        ):
            chosen = rows[:, FRAMES] == frames
            mine, places = rows[chosen], first[chosen]
            if not len(mine):
                continue
            rise = mine[:, END_LEVEL] - mine[:, START_LEVEL]
            _, hop = np.unique(places, return_inverse=True)
            rising = np.bincount(hop, rise)[hop] > synthesis.still
            shape = np.where(rising[:, None], rise_shape, glide_shape(steps))
            level = mine[:, START_LEVEL, None] + rise[:, None] * shape
            turn, glide = glide_turns(steps, frames / self._grid_rate)
            hz = mine[:, START_HZ, None]
            bend = mine[:, END_HZ, None] - hz
            angle = hz * turn + bend * glide + 2.0 * np.pi * mine[:, START_PHASE, None]
            signal = level * np.exp(1j * angle)
            power = level * level
            moment = power * (hz + bend * glide_shape(steps))
            for row, place in enumerate(places.tolist()):
                self._signal[place : place + steps] += signal[row]
                self._power[place : place + steps] += power[row]
                self._moment[place : place + steps] += moment[row]

    def take(self, steps: int) -> tuple[NDArray[np.complex128], FloatArray, FloatArray]:
        """Return the next steps: signal, sum of the partials' powers, and that times frequency."""
        self._reserve(steps)
        signal, self._signal = self._signal[:steps], self._signal[steps:]
        power, self._power = self._power[:steps], self._power[steps:]
        moment, self._moment = self._moment[:steps], self._moment[steps:]
        self._next += steps
        smooth, self._state = lfilter(
            self._synthesis.low_b, self._synthesis.low_a, signal, zi=self._state
        )
        return smooth, power, moment

    @property
    def _grid_rate(self) -> float:
        return self._grid.hop_frames / self._grid.hop_s

    def _reserve(self, steps: int) -> None:
        lacking = steps - self._signal.size
        if lacking > 0:
            more = np.zeros(lacking)
            self._signal = np.concatenate((self._signal, more))
            self._power = np.concatenate((self._power, more))
            self._moment = np.concatenate((self._moment, more))


class CurveReader:
    """Makes the curve of one channel from its glides, block by block.

    Memory: 4 kB a second. gain: factor on all amplitudes. Use from one thread.
    """

    def __init__(self, design: LiveDesign, gain: float) -> None:
        self._played = PlayedGlides(design)
        self._vibration = AnalyticVibration(design)
        self._gain = gain
        self._first_fresh = 2 * (design.analysis.partials_max + design.onsets.fresh_max)
        self._steps = max(1, round(self._played.low_rate_hz / CURVE_RATE_HZ))
        self._powers: list[NDArray[np.float32]] = []
        self._hz: list[NDArray[np.float32]] = []
        self._births: list[tuple[float, float, float]] = []
        self._samples = 0

    def add(self, rows: FloatArray, frame: int) -> None:
        """Take this channel's rows; all that begin before this frame are there."""
        fresh = rows[:, SLOT] >= self._first_fresh
        born = rows[fresh & (rows[:, START_LEVEL] == 0.0) & (rows[:, END_LEVEL] > 0.0)]
        self._births += [(row[FRAME], row[START_HZ], row[END_LEVEL]) for row in born.tolist()]
        self._vibration.add(rows)
        samples = int(frame // (self._played.decimation * self._steps)) - self._samples
        if samples <= 0:
            return
        self._samples += samples
        signal, power, moment = self._vibration.take(samples * self._steps)
        squares = (signal.real**2 + signal.imag**2).reshape(-1, self._steps).mean(axis=1)
        power = power.reshape(-1, self._steps).sum(axis=1)
        moment = moment.reshape(-1, self._steps).sum(axis=1)
        silent = power <= 0.0
        hz = np.where(silent, np.nan, moment / np.where(silent, 1.0, power))
        self._powers.append((self._gain**2 * squares).astype(np.float32))
        self._hz.append(hz.astype(np.float32))

    def curve(self, duration_s: float) -> VibrationCurve:
        """Return the curve from the start to the end of the sound."""
        played = self._played
        rate_hz = played.low_rate_hz / self._steps
        # The centre of the first sample, in the aligned vibration.
        centre_frames = (self._steps - 1) / 2 * played.decimation + played.interpolation_frames
        first_s = (centre_frames - played.latency_frames) / played.samplerate
        amplitude = np.sqrt(np.concatenate([*self._powers, np.zeros(1, np.float32)]))
        late = round(played.low_pass_s * rate_hz)
        hz = held(np.concatenate([np.full(late + 1, np.nan, np.float32), *self._hz]))
        dropped = max(0, int(np.ceil(-first_s * rate_hz)))
        kept = max(1, int(duration_s * rate_hz))
        start_s = first_s + dropped / rate_hz
        amplitude, hz = amplitude[dropped:][:kept], hz[dropped:][: min(kept, amplitude.size)]
        curve = VibrationCurve(rate_hz, start_s, amplitude, hz[: amplitude.size], ())
        return VibrationCurve(rate_hz, start_s, amplitude, curve.hz, self._onsets(curve))

    def _onsets(self, curve: VibrationCurve) -> tuple[Onset, ...]:
        """Return the births of partials that raise the envelope, where it rises most."""
        level, found = curve.amplitude, list[Onset]()
        loudest = float(level.max(initial=0.0))
        reach = max(2, round(ONSET_REACH_S * curve.rate_hz))
        for frame, hz, _ in sorted(self._births):
            born_s = frame / self._played.samplerate + self._played.shift_s
            place = round((born_s - self._played.low_pass_s - curve.start_s) * curve.rate_hz)
            place = max(1, place)
            window = level[place - 1 : place + reach].astype(np.float64)
            if window.size < 3:
                continue
            steepest = place + int(np.diff(window).argmax())
            time_s = curve.start_s + (steepest - 0.5) / curve.rate_hz
            before = float(level[max(0, steepest - reach) : steepest].min())
            after = float(level[steepest : steepest + reach].max())
            rise = after - before
            if rise < max(RISE_FROM * after, AUDIBLE * loudest) or time_s <= 0.0:
                continue
            if found and time_s - found[-1].time_s < ONSETS_APART_S:
                continue
            found.append(Onset(time_s, before, after, hz))
        return tuple(found)


def held(hz: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return frequencies with the last known one in place of NaN; 100 Hz if none is known."""
    known = np.isfinite(hz)
    if not known.any():
        return np.full(hz.size, 100.0, np.float32)
    place = np.where(known, np.arange(hz.size), -1)
    last = np.maximum.accumulate(place)
    last[last < 0] = int(known.argmax())
    return hz[last]
