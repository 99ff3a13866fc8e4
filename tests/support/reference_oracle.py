"""An independent loop-form of the transform's equations, as an oracle for the tests.

It follows the paper's equations step by step in float64, with loops over units, bins and walks. It
imports nothing from the package, so that both can be wrong only separately.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len, rfft  # type: ignore[import-untyped, unused-ignore]
from scipy.signal import butter, sosfilt  # type: ignore[import-untyped, unused-ignore]

Float64Array = npt.NDArray[np.float64]

LARGEST_SAMPLE = 1e3
PARABOLA_POWER = 0.2
HAMMING_HALF_POWER_BINS = 1.30
WINDOW_S = 0.04643


@dataclass(frozen=True)
class OraclePrincipal:
    """One principal frequency of one unit: f_cp, A_f, the half-power width, A_f df, and s(f_cp)."""

    audio_hz: float
    amplitude: float
    bandwidth_hz: float
    r: float
    vibration_hz: float


def oracle_units(
    signal: npt.ArrayLike,
    samplerate: float,
    *,
    window_s: float = WINDOW_S,
    band_low_hz: float = 50.0,
    band_high_hz: float = 12000.0,
    vibration_top_hz: float = 220.0,
    threshold: float = 0.3,
    partials_max: int = 16,
) -> list[list[OraclePrincipal]]:
    """The principal frequencies of every unit of (frames,) or (frames, channels), ascending."""
    filtered = _band_passed(_mono(signal), samplerate, band_low_hz, band_high_hz)
    length = _unit_length(window_s, samplerate)
    units: list[list[OraclePrincipal]] = []
    # Open: the zeros follow the filter, so its ringing past the input's end is not heard.
    for unit in np.pad(filtered, (0, -len(filtered) % length)).reshape(-1, length):
        spectrum, nfft = _amplitude_spectrum(unit)
        found: list[OraclePrincipal] = []
        # Open: a bin without two neighbours (0 and the last) is no candidate.
        for k in range(1, len(spectrum) - 1):
            if not spectrum[k - 1] < spectrum[k] >= spectrum[k + 1]:
                continue
            # Open: the band is asked of the bin, so a refined f_cp may lie just outside it.
            if not band_low_hz <= k * samplerate / nfft <= band_high_hz:
                continue
            offset, amplitude = _refined(spectrum, k)
            audio_hz, level = (k + offset) * samplerate / nfft, amplitude / math.sqrt(2.0)
            bins = _side(spectrum, k, +1, level) - _side(spectrum, k, -1, level)
            bandwidth_hz = bins * samplerate / nfft
            r = amplitude * bandwidth_hz
            if r > threshold:
                felt_hz = _scaled(audio_hz, window_s, band_low_hz, band_high_hz, vibration_top_hz)
                found.append(OraclePrincipal(audio_hz, amplitude, bandwidth_hz, r, felt_hz))
        found.sort(key=lambda principal: (-principal.r, principal.audio_hz))
        units.append(sorted(found[:partials_max], key=lambda principal: principal.audio_hz))
    return units


def oracle_vibration(
    signal: npt.ArrayLike, samplerate: float, *, window_s: float = WINDOW_S, **parameters: Any
) -> Float64Array:
    """The vibration, (frames,), as long as the input and not limited; parameters: of the units."""
    units = oracle_units(signal, samplerate, window_s=window_s, **parameters)
    length = _unit_length(window_s, samplerate)
    # Every unit starts its own clock at 0, so the cosines step in phase at the unit edges.
    t = np.arange(length, dtype=np.float64) / samplerate
    full_scale = HAMMING_HALF_POWER_BINS * samplerate / length
    vibration = np.zeros((len(units), length))
    for g, unit in zip(vibration, units, strict=True):
        # Open: the sum of r runs over the frequencies that were kept, not over the pruned ones.
        total_r = math.fsum(principal.r for principal in unit)
        for principal in unit:
            share = principal.r / total_r
            g += share * principal.r * np.cos(2.0 * np.pi * principal.vibration_hz * t)
    return (vibration / full_scale).reshape(-1)[: len(np.asarray(signal))]


def _mono(signal: npt.ArrayLike) -> Float64Array:
    """The mean of the channels, float64, shape (frames,), unusable samples replaced by 0."""
    samples = np.array(signal, dtype=np.float64)
    if samples.ndim == 1:
        samples = samples.reshape(-1, 1)
    # A sample of exactly 1e3 stays; a bad channel counts as 0 in the mean over all channels.
    usable = np.isfinite(samples) & (np.abs(samples) <= LARGEST_SAMPLE)
    mono: Float64Array = np.where(usable, samples, 0.0).mean(axis=1)
    return mono


def _band_passed(mono: Float64Array, samplerate: float, low: float, high: float) -> Float64Array:
    """The band-passed signal, shape (frames,), from zero state; a high-pass at a low samplerate."""
    if len(mono) == 0:
        return mono
    if high >= 0.49 * samplerate:
        sos = butter(2, low, "highpass", fs=samplerate, output="sos")
    else:
        sos = butter(2, (low, high), "bandpass", fs=samplerate, output="sos")
    return np.asarray(sosfilt(sos, mono), dtype=np.float64)


def _unit_length(window_s: float, samplerate: float) -> int:
    """The frames N of one unit, which is also the hop."""
    # Open: an exact half goes to the even neighbour, as Python rounds.
    return round(window_s * samplerate)


def _amplitude_spectrum(unit: Float64Array) -> tuple[list[float], int]:
    """The amplitudes A[k] of the bins k * samplerate / NFFT, up to the last bin, and NFFT."""
    length = len(unit)
    window = np.array([0.54 - 0.46 * math.cos(2.0 * math.pi * i / length) for i in range(length)])
    nfft = int(next_fast_len(2 * length, real=True))
    # Open: the factor 2 holds for every bin, bin 0 and the Nyquist bin included.
    amplitudes = [2.0 * abs(x) / float(window.sum()) for x in rfft(window * unit, nfft)]
    return [float(a) for a in amplitudes], nfft


def _refined(spectrum: list[float], k: int) -> tuple[float, float]:
    """The offset d in bins and the amplitude A_f of the parabola's top through A^0.2 about k."""
    below = spectrum[k - 1] ** PARABOLA_POWER
    middle = spectrum[k] ** PARABOLA_POWER
    above = spectrum[k + 1] ** PARABOLA_POWER
    curvature = below - 2.0 * middle + above
    # Open: three powers that round to the same number have no top; the bin itself stands.
    offset = 0.0 if curvature == 0.0 else (below - above) / (2.0 * curvature)
    top = middle - (below - above) * offset / 4.0
    return offset, top ** (1.0 / PARABOLA_POWER)


def _side(spectrum: list[float], k: int, step: int, level: float) -> float:
    """Where one side of the half-power width ends, as a fractional bin; step is -1 or +1."""
    # Open: A at the bin itself may already be below A_f/sqrt(2); then both sides end at the bin.
    j = k
    # The walk may leave the band: only the spectrum's own ends stop it.
    while spectrum[k] >= level and 0 <= j + step < len(spectrum):
        here, following = spectrum[j], spectrum[j + step]
        # Equal amplitudes do not rise: a flat valley ends at its far bin.
        if following > here:
            break
        if following < level:
            return j + step * (here - level) / (here - following)
        j += step
    return float(j)


def _scaled(x: float, window_s: float, f_m: float, f_h: float, top: float) -> float:
    """The vibration frequency s(x) in Hz of an audio frequency x in Hz."""
    # Open: T is the nominal window in seconds, not the rounded N / samplerate.
    f_b = 1.0 / window_s
    b_c = (top - f_b) / math.log(f_h / f_m)
    return b_c * math.log(x / f_m) + f_b
