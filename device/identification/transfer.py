"""Transfer function with coherence, and distortion by order, from one sweep. Pure functions."""

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft

from device.identification.recording import ComplexArray, Recording
from device.units import FloatArray

_BEFORE_S = 0.05
_FADE_SHARE = 0.2
_SMOOTH_BINS = 15


@dataclass(frozen=True)
class Transfer:
    """Response for reference inside the swept band, (bins,) each.

    frequencies_hz; response: complex, in the unit of the response per that of the reference;
    coherence: 0 to 1, the share of the response's power that follows the sweep linearly.
    """

    frequencies_hz: FloatArray
    response: ComplexArray
    coherence: FloatArray


def transfer(recording: Recording) -> Transfer:
    """The transfer function without what its harmonics and the noise outside its time add.

    The impulse response is cut from shortly before its start to as long as the silence after the
    sweep. Coherence is of means over 15 bins: of what is left beside that response.
    """
    rate = recording.sweep.samplerate
    impulse = _impulse_response(recording)
    before, after = round(_BEFORE_S * rate), round(recording.sweep.tail_s * rate)
    gate = np.zeros(recording.length)
    gate[:after] = _fade_out(after)
    gate[-before:] = _fade_out(before)[::-1]
    response = np.asarray(rfft(impulse * gate))
    band = recording.band
    measured = recording.response_spectrum[band]
    left = measured - response[band] * recording.reference_spectrum[band]
    share = _smooth(np.abs(left) ** 2) / np.maximum(_smooth(np.abs(measured) ** 2), 1e-300)
    return Transfer(recording.frequencies_hz[band], response[band], np.clip(1.0 - share, 0.0, 1.0))


@dataclass(frozen=True)
class Distortion:
    """What one order adds. order: 2 or more; frequencies_hz: of the drive; share: of the linear
    response at the drive's frequency, by amplitude, (bins,).

    It is limited by the noise: below `floor`, what silence in its place would show, is nothing.
    """

    order: int
    frequencies_hz: FloatArray
    share: FloatArray
    floor: FloatArray


def distortion(recording: Recording, orders: int = 5) -> list[Distortion]:
    """Harmonic distortion of orders 2 to `orders`, at drives whose harmonic is in the band.

    Orders that have none are left out.

    A sweep's harmonic of order n runs ahead of it by rise ln n, so its impulse response stands
    alone there (Farina 2000). The floor is taken half way to the next one and to the one before,
    whichever is more: a response that rings at the ends of the band reaches far ahead of itself.
    """
    sweep, rate = recording.sweep, recording.sweep.samplerate
    impulse = _impulse_response(recording)
    linear = np.abs(transfer(recording).response)
    f = recording.frequencies_hz[recording.band]
    found = []
    for order in range(2, orders + 1):
        before, lead, after = (sweep.harmonic_lead_s(n) for n in (order - 1, order, order + 1))
        half = round(0.25 * (after - lead) * rate)
        drives = f[f * order <= f[-1]]
        shares = []
        times_s = [lead, 0.5 * (lead + before), 0.5 * (lead + after)]
        fit = [time_s for time_s in times_s if round(time_s * rate) + half <= recording.length]
        if not len(drives) or lead not in fit:
            break  # this one and all above have no place in the band, or in the recording
        for time_s in fit:
            part = _cut(impulse, -round(time_s * rate), half)
            spectrum = np.abs(rfft(part))[recording.band]
            shares.append(np.interp(order * drives, f, spectrum) / np.interp(drives, f, linear))
        found.append(Distortion(order, drives, shares[0], np.max(shares[1:], axis=0)))
    return found


def _impulse_response(recording: Recording) -> FloatArray:
    """(length,) by deconvolution in the swept band; its end is what came before time 0."""
    reference, response = recording.reference_spectrum, recording.response_spectrum
    f, sweep = recording.frequencies_hz, recording.sweep
    # Outside the band there is nothing to divide by; a soft edge does not ring into the response.
    edge = np.clip((f / sweep.low_hz - 0.8) / 0.2, 0.0, 1.0)
    edge *= np.clip((1.1 - f / sweep.high_hz) / 0.1, 0.0, 1.0)
    power = np.abs(reference) ** 2
    floor = 1e-6 * float(power[recording.band].max(initial=1e-300))
    return np.asarray(irfft(edge * response * reference.conj() / (power + floor), recording.length))


def _fade_out(frames: int) -> FloatArray:
    window = np.ones(frames)
    fade = max(1, round(_FADE_SHARE * frames))
    window[-fade:] = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, fade + 1) / fade)
    return window


def _cut(impulse: FloatArray, centre: int, half: int) -> FloatArray:
    """What is within half frames of a place, at that place; the rest 0."""
    frames = np.arange(centre - half, centre + half)
    part = np.zeros_like(impulse)
    part[frames] = impulse[frames] * np.hanning(2 * half)
    return part


def _smooth(power: FloatArray) -> FloatArray:
    box = np.ones(_SMOOTH_BINS)
    width = np.convolve(np.ones_like(power), box, "same")
    return np.convolve(power, box, "same") / width


LOW_COHERENCE = 0.9
"""Below, a tenth of the response's power is noise, distortion or something else."""

ABOVE_FLOOR = 3.0
"""Distortion below so many times what silence in its place shows is noise."""

_JOINED_HZ = 2.0
_SMOOTH_HZ = 5.0
"""Shares are r.m.s. values over so much: the largest of many bins of noise would look like one."""


@dataclass(frozen=True)
class Harmonic:
    """The most that one order adds. order: 2 or more; largest_share: of the linear response, by
    amplitude, at a drive of at_hz; 0 where nothing stands above the noise.
    """

    order: int
    largest_share: float
    at_hz: float


@dataclass(frozen=True)
class Quality:
    """Of one recording. names: its reference and response; coherence: the median; low_hz: the
    ranges, Hz, in which it is below LOW_COHERENCE; harmonics: by order,
    those that band and length of the sweep have room for.
    """

    names: tuple[str, str]
    coherence: float
    low_hz: tuple[tuple[float, float], ...]
    harmonics: tuple[Harmonic, ...]


def quality(recording: Recording, orders: int = 5) -> Quality:
    """What can be said of a recording besides its fit."""
    found = transfer(recording)
    f = found.frequencies_hz
    ranges: list[tuple[float, float]] = []
    for hz in f[found.coherence < LOW_COHERENCE]:
        if ranges and hz - ranges[-1][1] <= _JOINED_HZ:
            ranges[-1] = ranges[-1][0], float(hz)
        else:
            ranges.append((float(hz), float(hz)))
    harmonics = []
    sweep = recording.sweep
    for one in distortion(recording, orders):
        apart_s = sweep.harmonic_lead_s(one.order + 1) - sweep.harmonic_lead_s(one.order)
        if 0.5 * apart_s < 1.0 / sweep.low_hz:
            break  # the sweep is too quick to tell such orders apart
        step_hz = float(f[1] - f[0])
        share, floor = (
            _rms_smooth(values, _SMOOTH_HZ / step_hz) for values in (one.share, one.floor)
        )
        clear = np.where(share > ABOVE_FLOOR * floor, share, 0.0)
        at = int(np.argmax(clear))
        hz = float(one.frequencies_hz[at]) if clear[at] > 0.0 else 0.0
        harmonics.append(Harmonic(one.order, float(clear[at]), hz))
    return Quality(
        recording.names, float(np.median(found.coherence)), tuple(ranges), tuple(harmonics)
    )


def _rms_smooth(values: FloatArray, bins: float) -> FloatArray:
    """R.m.s. over so many bins around each."""
    box = np.ones(max(1, min(round(bins), len(values))))
    mean = np.convolve(values**2, box, "same") / np.convolve(np.ones_like(values), box, "same")
    return np.asarray(np.sqrt(mean))
