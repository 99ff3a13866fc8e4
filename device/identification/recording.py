"""The exponential sine sweep, and a recording of it: one reference, one response, their spectra.

The sweep's frequency rises exponentially. After deconvolution, each order of distortion therefore
precedes the linear response by a different time (Farina, AES 108th Convention, 2000).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from device.errors import UsageError
from device.units import FloatArray

PLAYED = "played signal"  # name of the reference if it is the played samples

_HUM_REACH_HZ = 2.0  # bins this near a multiple of the mains frequency are not used in fits

ComplexArray = NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True)
class Sweep:
    """A sweep with silence before and after it; full scale is 1.0."""

    low_hz: float = 20.0
    high_hz: float = 400.0
    duration_s: float = 5.0  # of the sweep itself
    level: float = 0.1  # amplitude, above 0, up to 1
    lead_s: float = 0.2  # silence before the sweep, in which noise is measured
    tail_s: float = 0.8  # silence after the sweep, in which the rig comes to rest
    samplerate: int = 48_000

    def __post_init__(self) -> None:
        checks = {
            f"samplerate={self.samplerate!r} Hz must be 1000 or more": self.samplerate >= 1_000,
            f"low_hz={self.low_hz!r} must be 1 or more": self.low_hz >= 1.0,
            f"high_hz={self.high_hz!r} must be at least twice low_hz and at most 0.4 of the "
            f"sample rate": 2.0 * self.low_hz <= self.high_hz <= 0.4 * self.samplerate,
            f"duration_s={self.duration_s!r} must be 0.5 to 60": 0.5 <= self.duration_s <= 60.0,
            f"level={self.level!r} must be above 0, up to 1": 0.0 < self.level <= 1.0,
            f"lead_s={self.lead_s!r} must be 0.1 to 10": 0.1 <= self.lead_s <= 10.0,
            f"tail_s={self.tail_s!r} must be 0.1 to 10": 0.1 <= self.tail_s <= 10.0,
        }
        if wrong := [words for words, holds in checks.items() if not holds]:
            raise UsageError(f"sweep: {'; '.join(wrong)}; choose another value")

    def wave(self, frames: int, duration_s: float) -> FloatArray:
        """Return a sweep from low_hz to high_hz in duration_s, (frames,), without fades."""
        rise_s = duration_s / math.log(self.high_hz / self.low_hz)
        time_s = np.arange(frames) / self.samplerate
        return np.asarray(np.sin(math.tau * self.low_hz * rise_s * np.expm1(time_s / rise_s)))

    @property
    def lead_frames(self) -> int:
        """Frames of silence before the sweep."""
        return round(self.lead_s * self.samplerate)

    @property
    def frames(self) -> int:
        """Frames of the sweep and both silences."""
        return round((self.lead_s + self.duration_s + self.tail_s) * self.samplerate)

    def samples(self) -> FloatArray:
        """Return the sweep with its silences, (frames,), between ±level.

        The sweep fades in over two periods of low_hz, but at most over a tenth of duration_s. It
        fades out over 1 % of duration_s.
        """
        sounding = round(self.duration_s * self.samplerate)
        wave = self.wave(sounding, self.duration_s)
        fade_in = min(2.0 / self.low_hz, 0.1 * self.duration_s)
        for frames, part in (
            (round(fade_in * self.samplerate), wave),
            (round(0.01 * self.duration_s * self.samplerate), wave[::-1]),
        ):
            part[:frames] *= 0.5 - 0.5 * np.cos(np.pi * np.arange(frames) / frames)
        whole = np.zeros(self.frames)
        whole[self.lead_frames : self.lead_frames + sounding] = self.level * wave
        return whole

    def harmonic_lead_s(self, order: int) -> float:
        """Return the time in s by which a harmonic's response precedes the linear response."""
        return self.duration_s / math.log(self.high_hz / self.low_hz) * math.log(order)


MARK_S, GAP_S, REST_S = 0.25, 0.4, 0.2  # a mark; silence after the first mark; after the second


class Excitation:
    """The signal of one measurement: a mark, the sweep with its silences, the mark again.

    A mark is a short sweep. The rig changes both marks equally, so the time between their
    recordings gives the drift between the clocks of output and input.
    """

    def __init__(self, sweep: Sweep) -> None:
        self.sweep, rate = sweep, sweep.samplerate
        self.mark_frames = round(MARK_S * rate)
        # start of the sweep's first silence
        self.sweep_start = self.mark_frames + round(GAP_S * rate)
        self.second_mark = self.sweep_start + sweep.frames
        self.frames = self.second_mark + self.mark_frames + round(REST_S * rate)
        wave = sweep.wave(self.mark_frames, MARK_S)
        wave *= sweep.level * np.hanning(len(wave)) ** 0.25
        self.samples = np.zeros(self.frames)
        self.samples[: len(wave)] = wave
        self.samples[self.sweep_start : self.second_mark] = sweep.samples()
        self.samples[self.second_mark : self.second_mark + len(wave)] = wave


class IdentificationError(UsageError):
    """Identification failed and gives no value; the message states the reason and the remedy."""


@dataclass(frozen=True)
class Recording:
    """One reference and one response, (frames,) each, at the sweep's rate and length."""

    sweep: Sweep
    reference: FloatArray  # the drive: V, A, or samples as played
    response: FloatArray  # the response: m/s^2, A or V
    names: tuple[str, str] = ("drive", "acceleration")  # of reference and response
    limits: tuple[float, float] = (float("inf"), float("inf"))  # magnitude at which inputs clip
    correction: Any = None  # frequency response of the instruments, (bins,), to divide out
    high_pass_hz: float | None = None  # the amplifier's corner in `correction`; None: no amplifier
    hum_hz: float = 0.0  # mains frequency whose multiples are excluded from fits; 0: none
    delayed: bool = False  # whether the response has an unknown delay of some ms
    polarity_known: bool = True  # False: the response may be inverted
    drift_reach: float = 0.0  # half the 95 % interval of the remaining relative clock drift

    def __post_init__(self) -> None:
        for name, samples in zip(self.names, (self.reference, self.response), strict=True):
            if samples.shape != (self.sweep.frames,):
                raise IdentificationError(
                    f"{name} has shape {samples.shape}: ({self.sweep.frames},) was played; record "
                    "from the first to the last frame of the sweep"
                )
            if lost := int(np.count_nonzero(~np.isfinite(samples))):
                raise IdentificationError(
                    f"{name}: {lost} samples are not finite; check the input and record again"
                )

    @cached_property
    def length(self) -> int:
        """Length of the Fourier transform in frames: the recording and a few appended zeros."""
        return int(next_fast_len(self.sweep.frames, real=True))

    @cached_property
    def frequencies_hz(self) -> FloatArray:
        """Frequencies of the spectra, (bins,)."""
        return np.asarray(rfftfreq(self.length, 1.0 / self.sweep.samplerate))

    @cached_property
    def reference_spectrum(self) -> ComplexArray:
        """Spectrum of the reference, (bins,)."""
        return np.asarray(rfft(self.reference, self.length))

    @cached_property
    def response_spectrum(self) -> ComplexArray:
        """Spectrum of the response, (bins,), divided by `correction`."""
        spectrum = np.asarray(rfft(self.response, self.length))
        if self.correction is not None:
            # At 0 Hz, outside the band, the correction may be 0.
            spectrum = spectrum / np.where(self.frequencies_hz > 0.0, self.correction, 1.0)
        return spectrum

    @cached_property
    def band(self) -> slice:
        """The bins of the swept frequencies, without the faded ends."""
        f, sweep = self.frequencies_hz, self.sweep
        low, high = np.searchsorted(f, [1.05 * sweep.low_hz, 0.97 * sweep.high_hz])
        return slice(int(low), int(high))

    @cached_property
    def usable(self) -> NDArray[np.bool_]:
        """For each bin of `band`, whether it is free of mains hum."""
        f = self.frequencies_hz[self.band]
        if not self.hum_hz:
            return np.ones(len(f), np.bool_)
        nearest = np.maximum(np.rint(f / self.hum_hz), 1.0) * self.hum_hz
        return np.asarray(np.abs(f - nearest) > _HUM_REACH_HZ)

    def excursion_m(self, response: ComplexArray) -> float:
        """Return the peak excursion in m. response: in `band`, m/s^2 per unit of the reference."""
        f, spectrum = self.frequencies_hz[self.band], np.zeros(len(self.frequencies_hz), complex)
        motion = response * self.reference_spectrum[self.band]
        spectrum[self.band] = motion / -((2.0 * np.pi * f) ** 2)
        return float(np.abs(irfft(spectrum, self.length)).max())


def box_mean(values: FloatArray, bins: int) -> FloatArray:
    """Return the moving average over `bins` values; at the ends, over fewer."""
    box = np.ones(bins)
    width = np.convolve(np.ones_like(values), box, "same")
    return np.asarray(np.convolve(values, box, "same") / width)
