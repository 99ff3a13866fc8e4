"""Transfer function, coherence and distortion of a recording, and checks of the recording."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, rfft

from device.identification.recording import (
    PLAYED,
    ComplexArray,
    IdentificationError,
    Recording,
    box_mean,
)
from device.units import FloatArray

# Least number of samples in a row at the peak, and of such runs, that prove clipping.
_CLIPPED_RUN, _CLIPPED_RUNS = 3, 4
_AT_THE_LIMIT = 0.999
_MIN_SIGNAL = 1.5  # least ratio of a signal's r.m.s. to that of the silence before it
ORDERS = 5  # highest measured order of distortion
_BEFORE_S, _FADE_SHARE, _SMOOTH_BINS = 0.05, 0.2, 15


@dataclass(frozen=True)
class Transfer:
    """Response divided by reference inside the swept band, (bins,) each."""

    frequencies_hz: FloatArray
    response: ComplexArray  # in the unit of the response per unit of the reference
    coherence: FloatArray  # share of the response's power that is linear in the sweep


def estimate_transfer(recording: Recording) -> Transfer:
    """Return the transfer function; a window on the impulse response removes harmonics.

    Coherence is 1 - (residual power / response power); both powers are averaged over 15 bins.
    """
    rate = recording.sweep.samplerate
    impulse = _impulse_response(recording)
    after, before = (_fade_out(round(s * rate)) for s in (recording.sweep.tail_s, _BEFORE_S))
    gate = np.zeros(recording.length)
    gate[: len(after)], gate[-len(before) :] = after, before[::-1]
    response = np.asarray(rfft(impulse * gate))
    band = recording.band
    measured = recording.response_spectrum[band]
    left = measured - response[band] * recording.reference_spectrum[band]
    power = box_mean(np.abs(measured) ** 2, _SMOOTH_BINS)
    share = box_mean(np.abs(left) ** 2, _SMOOTH_BINS) / np.maximum(power, 1e-300)
    return Transfer(recording.frequencies_hz[band], response[band], np.clip(1.0 - share, 0.0, 1.0))


@dataclass(frozen=True)
class Distortion:
    """The distortion of one order; a share below the floor is noise."""

    order: int  # 2 or more
    frequencies_hz: FloatArray  # of the drive, (bins,)
    share: FloatArray  # amplitude relative to the linear response at the drive frequency, (bins,)
    floor: FloatArray  # as `share`, but half way in time between two harmonics, (bins,)


def measure_distortion(recording: Recording) -> list[Distortion]:
    """Return the distortion of orders 2 to ORDERS at all frequencies whose harmonic is in the band.

    In the impulse response, each order appears at its own time. `floor` is the larger of two
    shares: half way in time to the previous order, and half way to the next order.
    """
    sweep, rate = recording.sweep, recording.sweep.samplerate
    impulse = _impulse_response(recording)
    linear = np.abs(estimate_transfer(recording).response)
    f = recording.frequencies_hz[recording.band]
    found = []
    for order in range(2, ORDERS + 1):
        before, lead, after = (sweep.harmonic_lead_s(n) for n in (order - 1, order, order + 1))
        half = round(0.25 * (after - lead) * rate)
        drives = f[f * order <= f[-1]]
        shares = []
        times_s = [lead, 0.5 * (lead + before), 0.5 * (lead + after)]
        fit = [time_s for time_s in times_s if round(time_s * rate) + half <= recording.length]
        if not len(drives) or lead not in fit:
            break  # the band or the recording is too short for this order and higher orders
        for time_s in fit:
            # Keep only the impulse response near this time.
            frames = np.arange(-half, half) - round(time_s * rate)
            part = np.zeros_like(impulse)
            part[frames] = impulse[frames] * np.hanning(2 * half)
            spectrum = np.abs(rfft(part))[recording.band]
            shares.append(np.interp(order * drives, f, spectrum) / np.interp(drives, f, linear))
        found.append(Distortion(order, drives, shares[0], np.max(shares[1:], axis=0)))
    return found


def _impulse_response(recording: Recording) -> FloatArray:
    """Return the impulse response in the swept band, (length,); negative times are at its end."""
    reference, response = recording.reference_spectrum, recording.response_spectrum
    f, sweep = recording.frequencies_hz, recording.sweep
    # The spectrum is weak outside the band; a soft edge limits the oscillation of the response.
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


LOW_COHERENCE = 0.9  # at a lower value, over a tenth of the response's power is not linear
ABOVE_FLOOR = 3.0  # least ratio of distortion to its floor
_JOINED_HZ = 2.0
_SMOOTH_HZ = 5.0  # width of r.m.s. smoothing; without it, the largest of many bins is noise


@dataclass(frozen=True)
class Harmonic:
    """Largest distortion of one order; 0 if it is not above `ABOVE_FLOOR` times its floor."""

    order: int  # 2 or more
    largest_share: float  # amplitude relative to the linear response
    at_hz: float  # frequency of the drive


@dataclass(frozen=True)
class Quality:
    """Linearity of one recording's response."""

    names: tuple[str, str]
    coherence: float  # median over the band
    low_hz: tuple[tuple[float, float], ...]  # ranges with coherence below LOW_COHERENCE
    harmonics: tuple[Harmonic, ...]  # all orders that can be measured in this band and sweep


def assess_quality(recording: Recording) -> Quality:
    """Return coherence and distortion of a recording."""
    found = estimate_transfer(recording)
    f = found.frequencies_hz
    low = f[found.coherence < LOW_COHERENCE]
    parts = np.split(low, np.flatnonzero(np.diff(low) > _JOINED_HZ) + 1)
    ranges = tuple((float(part[0]), float(part[-1])) for part in parts if len(part))
    harmonics = []
    sweep = recording.sweep
    for one in measure_distortion(recording):
        apart_s = sweep.harmonic_lead_s(one.order + 1) - sweep.harmonic_lead_s(one.order)
        if 0.5 * apart_s < 1.0 / sweep.low_hz:
            break  # the sweep is too short to separate these orders
        bins = max(1, min(round(_SMOOTH_HZ / float(f[1] - f[0])), len(one.share)))
        share, floor = (np.sqrt(box_mean(values**2, bins)) for values in (one.share, one.floor))
        clear = np.where(share > ABOVE_FLOOR * floor, share, 0.0)
        at = int(np.argmax(clear))
        hz = float(one.frequencies_hz[at]) if clear[at] > 0.0 else 0.0
        harmonics.append(Harmonic(one.order, float(clear[at]), hz))
    return Quality(recording.names, float(np.median(found.coherence)), ranges, tuple(harmonics))


def check_recording(recording: Recording) -> None:
    """Raise IdentificationError if a recording has no signal, clips or is of the wrong channel."""
    lead = slice(0, round(0.9 * recording.sweep.lead_frames))
    sounding = slice(recording.sweep.lead_frames, None)
    signals = (recording.reference, recording.response)
    for name, samples in zip(recording.names, signals, strict=True):
        noise, whole = float(np.std(samples[lead])), float(np.std(samples[sounding]))
        if whole <= _MIN_SIGNAL * noise or not np.any(samples[sounding]):
            raise IdentificationError(
                f"{name}: no signal, {whole:.3g} r.m.s. during the sweep and {noise:.3g} in the "
                "silence before it; check power, cables and that channel, or raise the level"
            )
    found = estimate_transfer(replace(recording, correction=None))
    if (coherent := float(np.median(found.coherence))) < 0.3:
        raise IdentificationError(
            f"{recording.names[1]} does not follow the sweep: its coherence is {coherent:.2f}, it "
            "must be 0.3 or more; this is another channel, or noise: check the inputs"
        )
    gain = np.abs(found.response)
    spread = float(np.std(found.response) / np.mean(gain))
    if spread < 0.02 and recording.names[0] != PLAYED:
        raise IdentificationError(
            f"{recording.names[1]} is the {recording.names[0]} itself, times {np.mean(gain):.3g}, "
            f"to {100 * spread:.1f} %; this is the wrong channel: check the inputs"
        )
    for name, samples, limit in zip(recording.names, signals, recording.limits, strict=True):
        if clipped := _count_clipped(samples, limit, plateaus=samples is recording.response):
            raise IdentificationError(
                f"{name}: {clipped} samples clip at {np.abs(samples).max():.4g}; lower the "
                "level, or the gain of that input"
            )


def _count_clipped(samples: FloatArray, limit: float, *, plateaus: bool) -> int:
    """Count samples at the limit. plateaus: if there are none, count the samples of flat peaks."""
    magnitude = np.abs(samples)
    beyond = int(np.count_nonzero(magnitude >= _AT_THE_LIMIT * limit))
    if beyond or not plateaus:
        return beyond
    at_peak = magnitude >= magnitude.max() * (1.0 - 1e-4)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], at_peak.astype(np.int8), [0]])))
    runs = ends[1::2] - ends[::2]
    runs = runs[runs >= _CLIPPED_RUN]
    return int(runs.sum()) if len(runs) >= _CLIPPED_RUNS else 0
