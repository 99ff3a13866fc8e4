"""Measures of vibration and of detected frequencies: pure functions.

Vibration is (frames,) float64 at full scale +-1. Silence gives -inf or NaN, never an exception.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.signal import butter, hilbert, sosfiltfilt

from audioflinger_hook.transform import FloatArray
from audioflinger_hook.transform.arrays import IntArray

FIT_ROUNDS_MAX = 8
FIT_CONVERGED_CYCLES = 1e-9
"""The fit has converged when a round moves it by less than this over its whole length."""

ENVELOPE_HZ = 60.0
SETTLED_FROM_S, SETTLED_TO_S = 0.1, 0.2
EARLIEST_S = 0.05
"""The zero-phase low-pass may smear an onset forward by less than this."""

ABSOLUTE_ZERO_DB = -300.0
"""Energy ratios under this are rounding, and become -inf."""


@dataclass(frozen=True)
class SineFit:
    """The best-fitting sinusoid: frequency_hz, amplitude, and the residual's energy against its.

    residual_db is THD+N: everything that is not this one sinusoid, an offset included.
    """

    frequency_hz: float
    amplitude: float
    residual_db: float


def sine_fit(vibration: FloatArray, samplerate: int) -> SineFit:
    """Return the sinusoid nearest to the vibration in the least-squares sense.

    The four-parameter fit of IEEE 1057 without its offset, started at the strongest line of the
    spectrum. For -80 dB of residual a second of vibration suffices.
    """
    frames = vibration.size
    spectrum = np.abs(np.fft.rfft(vibration * np.hanning(frames)))
    line = int(spectrum[1:-1].argmax()) + 1
    if spectrum[line] == 0.0:
        return SineFit(float("nan"), 0.0, -float("inf"))
    left, middle, right = np.log(np.maximum(spectrum[line - 1 : line + 2], 1e-300))
    offset = 0.5 * (left - right) / (left - 2.0 * middle + right)
    turns = float(line + offset) / frames  # cycles a frame

    # Counted from the middle, so that frequency and phase hardly depend on each other.
    time = np.arange(frames, dtype=np.float64)
    time -= (frames - 1) / 2.0
    step = 1.0
    for _ in range(FIT_ROUNDS_MAX):
        weights, residual, waves = _at_frequency(vibration, turns, time)
        if abs(step) * frames < FIT_CONVERGED_CYCLES:
            break
        slope = 2.0 * np.pi * time * (weights[1] * waves[0] - weights[0] * waves[1])
        columns = np.vstack((waves, slope))
        step = float(np.linalg.solve(columns @ columns.T, columns @ residual)[2])
        turns += step
    amplitude = float(np.hypot(*weights))
    return SineFit(
        float(turns * samplerate),
        amplitude,
        _ratio_db(float(residual @ residual) / frames, amplitude**2 / 2.0),
    )


def steady_fit(vibration: FloatArray, samplerate: int) -> float:
    """Return THD+N in dB against a sinusoid whose level and phase drift slowly.

    Over the whole length both follow parabolas, so that a slow change of level is no distortion.
    """
    fit = sine_fit(vibration, samplerate)
    if not fit.amplitude > 0.0:
        return -float("inf")
    place = np.linspace(-1.0, 1.0, vibration.size)
    turn = 2.0 * np.pi * fit.frequency_hz / samplerate * np.arange(vibration.size)
    waves = np.stack([place**power * wave(turn) for power in range(3) for wave in (np.cos, np.sin)])
    tone = np.linalg.solve(waves @ waves.T, waves @ vibration) @ waves
    residual = vibration - tone
    return _ratio_db(float(residual @ residual), float(tone @ tone))


def _at_frequency(
    vibration: FloatArray, turns: float, time: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return cosine and sine weight, residual and both waves of the fit at a known frequency."""
    turn = 2.0 * np.pi * turns * time
    waves = np.stack((np.cos(turn), np.sin(turn)))
    weights = np.linalg.solve(waves @ waves.T, waves @ vibration)
    return weights, vibration - weights @ waves, waves


def onset_lag_s(vibration: FloatArray, samplerate: int, onset_s: float) -> float:
    """Return how long after a burst's onset it is felt, in seconds, latency included; NaN if never.

    Felt: the envelope (magnitude of the analytic signal, low-passed at 60 Hz without phase)
    passes half of its mean from 100 to 200 ms after the onset.
    """
    low_pass = butter(2, ENVELOPE_HZ, fs=samplerate, output="sos")
    envelope = sosfiltfilt(low_pass, np.abs(hilbert(vibration)))
    onset = round(onset_s * samplerate)
    settled = envelope[
        onset + round(SETTLED_FROM_S * samplerate) : onset + round(SETTLED_TO_S * samplerate)
    ].mean()
    first = max(0, onset - round(EARLIEST_S * samplerate))
    felt = (envelope[first:] > settled / 2.0).nonzero()[0]
    if not settled > 0.0 or not felt.size:
        return float("nan")
    return float((first + felt[0] - onset) / samplerate)


def energy_above_db(vibration: FloatArray, samplerate: int, corner_hz: float = 250.0) -> float:
    """Return the share of energy above a corner, in dB of all of it; -inf for silence.

    The vibration should begin and end at rest, as there is no window.
    """
    spectrum = np.fft.rfft(vibration)
    power = spectrum.real**2 + spectrum.imag**2
    above = np.fft.rfftfreq(vibration.size, 1.0 / samplerate) > corner_hz
    return _ratio_db(float(power[above].sum()), float(power.sum()))


def energy_under_db(vibration: FloatArray, samplerate: int, corner_hz: float) -> float:
    """Return the share of energy under a corner, in dB of all of it; -inf for silence."""
    spectrum = np.fft.rfft(vibration, 2 * vibration.size)
    power = spectrum.real**2 + spectrum.imag**2
    under = np.fft.rfftfreq(2 * vibration.size, 1.0 / samplerate) < corner_hz
    return _ratio_db(float(power[under].sum()), float(power.sum()))


class Frequencies(Protocol):
    """Frequencies of several windows: parallel arrays."""

    @property
    def row(self) -> IntArray:
        """The number of the window."""

    @property
    def audio_hz(self) -> FloatArray:
        """The frequency in Hz."""


def agreement(found: Frequencies, wanted: Frequencies, reach_hz: float) -> FloatArray:
    """Return hits among the found, all found, hits among the wanted, and all wanted frequencies.

    A hit has one of the other set in reach, in the same row.
    """
    hits, wanted_hits = _in_reach(found, wanted, reach_hz), _in_reach(wanted, found, reach_hz)
    return np.array([hits, found.row.size, wanted_hits, wanted.row.size], dtype=np.float64)


def _in_reach(these: Frequencies, others: Frequencies, reach_hz: float) -> int:
    """Return how many of these have one of the others of the same row within reach_hz."""
    if not these.row.size or not others.row.size:
        return 0
    # Rows laid end to end, further apart than any band is wide: one sorted search for all.
    pitch_hz = 4.0 * max(these.audio_hz.max(), others.audio_hz.max())
    mine = these.row * pitch_hz + these.audio_hz
    theirs = np.sort(others.row * pitch_hz + others.audio_hz)
    after = theirs.searchsorted(mine)
    distance = np.minimum(
        np.abs(mine - theirs[np.minimum(after, theirs.size - 1)]),
        np.abs(mine - theirs[np.maximum(after - 1, 0)]),
    )
    return int(np.count_nonzero(distance <= reach_hz))


def _ratio_db(part: float, whole: float) -> float:
    """Return 10 log10(part / whole); -inf for nothing, or for less than float64 can tell."""
    if part <= 0.0 or whole <= 0.0:
        return -float("inf")
    level_db = 10.0 * float(np.log10(part / whole))
    return level_db if level_db > ABSOLUTE_ZERO_DB else -float("inf")
