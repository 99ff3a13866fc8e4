"""Functions that measure vibration, and functions that compare detected frequencies.

Vibration is (frames,) float64 with full scale ±1. For silence, levels in dB are -inf, frequencies
and delays are NaN, and no error is raised.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.signal import butter, hilbert, sosfiltfilt

from audioflinger_hook.transform import FloatArray
from audioflinger_hook.transform.arrays import IntArray

FIT_ROUNDS_MAX = 8
FIT_CONVERGED_CYCLES = 1e-9  # largest change in the last round of a converged fit
ENVELOPE_HZ = 60.0
SETTLED_FROM_S, SETTLED_TO_S = 0.1, 0.2
EARLIEST_S = 0.05  # the zero-phase low-pass advances an onset by less than this, in s
ABSOLUTE_ZERO_DB = -300.0  # lower energy ratios in dB are rounding errors, and become -inf


@dataclass(frozen=True)
class SineFit:
    """The sinusoid that fits a vibration best.

    residual_db: THD+N, the power of the rest of the vibration in dB relative to the sinusoid.
    """

    frequency_hz: float
    amplitude: float
    residual_db: float


def sine_fit(vibration: FloatArray, samplerate: int) -> SineFit:
    """Return the sinusoid with the least squared error.

    The method is the four-parameter fit of IEEE 1057 without offset. The fit starts at the
    strongest line of the spectrum.
    """
    frames = vibration.size
    spectrum = np.abs(np.fft.rfft(vibration * np.hanning(frames)))
    line = int(spectrum[1:-1].argmax()) + 1
    if spectrum[line] == 0.0:
        return SineFit(float("nan"), 0.0, -float("inf"))
    left, middle, right = np.log(np.maximum(spectrum[line - 1 : line + 2], 1e-300))
    offset = 0.5 * (left - right) / (left - 2.0 * middle + right)
    turns = float(line + offset) / frames  # cycles per frame

    # Times are relative to the middle, so that frequency and phase are nearly independent.
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
    """Return THD+N in dB relative to a fitted sinusoid with slowly varying level and phase.

    The amplitudes of sine and cosine are quadratic functions of time. A slow change of level thus
    does not count as distortion.
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
    turn = 2.0 * np.pi * turns * time
    waves = np.stack((np.cos(turn), np.sin(turn)))
    weights = np.linalg.solve(waves @ waves.T, waves @ vibration)
    return weights, vibration - weights @ waves, waves


def onset_lag_s(vibration: FloatArray, samplerate: int, onset_s: float) -> float:
    """Return the delay in s from a burst's onset to its vibration; NaN without vibration.

    The vibration starts when its envelope exceeds half of the mean envelope from 100 to 200 ms
    after the onset. The envelope is the magnitude of the analytic signal after a zero-phase
    low-pass at 60 Hz. The delay includes the latency of the method.
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
    """Return the energy above `corner_hz` in dB relative to the total energy; -inf for silence.

    The vibration should start and end at 0, since the spectrum is computed without a window.
    """
    spectrum = np.fft.rfft(vibration)
    power = spectrum.real**2 + spectrum.imag**2
    above = np.fft.rfftfreq(vibration.size, 1.0 / samplerate) > corner_hz
    return _ratio_db(float(power[above].sum()), float(power.sum()))


def energy_under_db(vibration: FloatArray, samplerate: int, corner_hz: float) -> float:
    """Return the energy below `corner_hz` in dB relative to the total energy; -inf for silence."""
    spectrum = np.fft.rfft(vibration, 2 * vibration.size)
    power = spectrum.real**2 + spectrum.imag**2
    under = np.fft.rfftfreq(2 * vibration.size, 1.0 / samplerate) < corner_hz
    return _ratio_db(float(power[under].sum()), float(power.sum()))


class Frequencies(Protocol):
    """Frequencies found in several windows of a signal, as two arrays of equal length."""

    @property
    def row(self) -> IntArray:
        """The index of the window in which each frequency was found."""

    @property
    def audio_hz(self) -> FloatArray:
        """The frequencies in Hz."""


def agreement(found: Frequencies, wanted: Frequencies, reach_hz: float) -> FloatArray:
    """Return the number of hits in `found`, the size of `found`, and both numbers for `wanted`.

    A frequency is a hit if it differs by at most `reach_hz` from a frequency of the other set in
    the same window.
    """
    hits, wanted_hits = _in_reach(found, wanted, reach_hz), _in_reach(wanted, found, reach_hz)
    return np.array([hits, found.row.size, wanted_hits, wanted.row.size], dtype=np.float64)


def _in_reach(these: Frequencies, others: Frequencies, reach_hz: float) -> int:
    if not these.row.size or not others.row.size:
        return 0
    # Rows are placed end to end, further apart than the bandwidth, so that one sorted search
    # suffices.
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
    if part <= 0.0 or whole <= 0.0:
        return -float("inf")
    level_db = 10.0 * float(np.log10(part / whole))
    return level_db if level_db > ABSOLUTE_ZERO_DB else -float("inf")
