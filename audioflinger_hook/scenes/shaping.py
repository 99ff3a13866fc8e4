"""Tools of synthesis. Mono signals are arrays of shape (frames,), stereo signals (frames, 2)."""

from __future__ import annotations  # numpy.random takes memory

from collections.abc import Sequence

import numpy as np
import scipy

from device.units import Float32Array, FloatArray


def times_s(duration_s: float, samplerate: int) -> FloatArray:
    """Return the time of each frame in seconds, shape (frames,)."""
    return np.arange(round(duration_s * samplerate)) / samplerate


def curve(time_s: FloatArray, points: Sequence[tuple[float, float]]) -> FloatArray:
    """Return a smooth curve through (seconds, value) points, evaluated at `time_s`.

    PCHIP interpolation is monotone between points, without overshoot. Before the first and after
    the last point the curve is constant.
    """
    knots_s, values = np.array(points, dtype=np.float64).T
    inside_s = np.clip(time_s, knots_s[0], knots_s[-1])
    smooth = scipy.interpolate.PchipInterpolator(knots_s, values)
    return np.asarray(smooth(inside_s), dtype=np.float64)


def phase(frequency_hz: FloatArray, samplerate: int) -> FloatArray:
    """Return the phase in radians of an oscillator with the given frequency in each frame."""
    return np.cumsum(frequency_hz) * (2.0 * np.pi / samplerate)


def band(
    signal: FloatArray, low_hz: float | None, high_hz: float | None, samplerate: int, order: int = 2
) -> FloatArray:
    """Return `signal` after a Butterworth filter along axis 0. A band edge of None is omitted."""
    high_hz = None if high_hz is None or high_hz >= 0.45 * samplerate else high_hz
    if not (corners_hz := [hz for hz in (low_hz, high_hz) if hz is not None]):
        return signal
    kind = "bandpass" if len(corners_hz) == 2 else "lowpass" if low_hz is None else "highpass"
    sos = scipy.signal.butter(order, np.squeeze(corners_hz), kind, fs=samplerate, output="sos")
    return np.asarray(scipy.signal.sosfilt(sos, signal, axis=0), dtype=np.float64)


def ring(push: FloatArray, frequency_hz: float, decay_s: float, samplerate: int) -> FloatArray:
    """Return the response of a two-pole resonator to the signal `push`.

    decay_s: time for a decay by 60 dB. An impulse of height 1 gives a sine of initial amplitude 1.
    """
    radius = 10.0 ** (-3.0 / (decay_s * samplerate))
    angle = 2.0 * np.pi * frequency_hz / samplerate
    numerator = [0.0, radius * np.sin(angle)]
    denominator = [1.0, -2.0 * radius * np.cos(angle), radius * radius]
    return np.asarray(scipy.signal.lfilter(numerator, denominator, push), dtype=np.float64)


def pan(mono: FloatArray, position: FloatArray | float) -> FloatArray:
    """Return `mono` panned from -1 (left) to 1 (right) at constant power, shape (frames, 2)."""
    angle = (np.clip(position, -1.0, 1.0) + 1.0) * (np.pi / 4.0)
    return np.stack([mono * np.cos(angle), mono * np.sin(angle)], axis=1)


def room(
    dry: FloatArray,
    samplerate: int,
    rng: np.random.Generator,
    *,
    decay_s: float,
    level: float,
    high_hz: float = 5000.0,
) -> FloatArray:
    """Return `dry` (frames, 2) with added reverberation, at the same length.

    decay_s: time for a decay by 60 dB. level: energy of the reverberation / energy of `dry`.
    """
    time_s = times_s(decay_s, samplerate)
    tail = rng.standard_normal((time_s.size, 2)) * 10.0 ** (-3.0 * time_s / decay_s)[:, None]
    tail = band(tail, 120.0, high_hz, samplerate, order=1)
    # Walls are some metres away, so the reverberation starts after 8 ms.
    tail[: round(0.008 * samplerate)] = 0.0
    tail *= np.sqrt(level / np.sum(tail**2, axis=0))
    wet = scipy.signal.fftconvolve(dry, tail, axes=0)[: dry.shape[0]]
    return np.asarray(dry + wet, dtype=np.float64)


def finished(
    frames: FloatArray, samplerate: int, *, peak: float, fade_in_s: float, fade_out_s: float
) -> Float32Array:
    """Return `frames` scaled to `peak`, with raised-cosine fades. First and last frame are 0."""
    frames = frames.copy()
    rise = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0.0, 1.0, max(2, round(fade_in_s * samplerate))))
    fall = 0.5 + 0.5 * np.cos(np.pi * np.linspace(0.0, 1.0, max(2, round(fade_out_s * samplerate))))
    frames[: rise.size] *= rise[:, None]
    frames[-fall.size :] *= fall[:, None]
    frames[-1] = 0.0
    frames *= peak / np.max(np.abs(frames))
    return frames.astype(np.float32)
