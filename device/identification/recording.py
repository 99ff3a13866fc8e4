"""A recording of a sweep: one reference, one response, and their spectra."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from device.errors import UsageError
from device.identification.sweep import Sweep
from device.units import FloatArray

PLAYED = "played signal"
"""The reference's name if it is the samples themselves."""

_HUM_REACH_HZ = 2.0
"""Half-width of a line of hum: its leakage, and the deviation of mains from 50 or 60 Hz."""

ComplexArray = NDArray[np.complexfloating[Any, Any]]


class IdentificationError(UsageError):
    """Identification failed and gives no value; the message says why and what to do."""


@dataclass(frozen=True)
class Recording:
    """One reference and one response, (frames,) each, at the sweep's rate and length."""

    sweep: Sweep
    reference: FloatArray  # the drive of the rig, V or A
    response: FloatArray  # the response of the rig, m/s^2 or A
    names: tuple[str, str] = ("drive", "acceleration")  # for messages
    limits: tuple[float, float] = (float("inf"), float("inf"))  # where the inputs clip
    correction: Any = None  # frequency response of the instruments, (bins,), to divide out
    high_pass_hz: float | None = None  # the amplifier's assumed corner in it; None: no amplifier
    hum_hz: float = 0.0  # mains frequency whose multiples no fit uses; 0: none
    delayed: bool = False  # the response has an unknown delay of some ms
    polarity_known: bool = True  # False: the response may be inverted
    drift_reach: float = 0.0  # half the 95 % interval of the remaining clock drift, as a share

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
        """Frames of the Fourier transform: those of the recording and a few zeros."""
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
        """Spectrum of the response, (bins,), divided by the instruments' correction."""
        spectrum = np.asarray(rfft(self.response, self.length))
        if self.correction is not None:
            # A high-pass is 0 at 0 Hz, which is outside the band anyway.
            correction = np.where(self.frequencies_hz > 0.0, self.correction, 1.0)
            spectrum = spectrum / correction
        return spectrum

    @cached_property
    def band(self) -> slice:
        """The bins inside the sweep, without its faded ends."""
        f, sweep = self.frequencies_hz, self.sweep
        low, high = np.searchsorted(f, [1.05 * sweep.low_hz, 0.97 * sweep.high_hz])
        return slice(int(low), int(high))

    @cached_property
    def usable(self) -> NDArray[np.bool_]:
        """Whether each bin of the band is free of hum."""
        f = self.frequencies_hz[self.band]
        if not self.hum_hz:
            return np.ones(len(f), np.bool_)
        nearest = np.maximum(np.rint(f / self.hum_hz), 1.0) * self.hum_hz
        return np.asarray(np.abs(f - nearest) > _HUM_REACH_HZ)

    def excursion_m(self, response: ComplexArray) -> float:
        """Return the peak excursion, m, of an acceleration response inside the band, (bins,)."""
        f, spectrum = self.frequencies_hz[self.band], np.zeros(len(self.frequencies_hz), complex)
        motion = response * self.reference_spectrum[self.band]
        spectrum[self.band] = motion / -((2.0 * np.pi * f) ** 2)
        return float(np.abs(irfft(spectrum, self.length)).max())


def box_mean(values: FloatArray, bins: int) -> FloatArray:
    """Return the mean over neighbouring bins, (bins,); there are fewer of them at the ends."""
    box = np.ones(bins)
    width = np.convolve(np.ones_like(values), box, "same")
    return np.asarray(np.convolve(values, box, "same") / width)
