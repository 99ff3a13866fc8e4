"""What was read while a sweep was played, and whether anything can be identified from it."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft, rfftfreq

from device.errors import UsageError
from device.identification.sweep import Sweep
from device.units import FloatArray

ComplexArray = NDArray[np.complexfloating[Any, Any]]

_CLIPPED_RUN, _CLIPPED_RUNS = 3, 4
"""So many samples in a row at the very peak, so often: one crest of a sine may stay within one of
a converter's steps, but the sweep's crests differ."""
_AT_THE_LIMIT = 0.999
_AUDIBLE = 1.5
"""A signal whose r.m.s. is less than that of the silence before it, times this, is none."""


class IdentificationError(UsageError):
    """Nothing was identified, so there is no number: what was wrong, and what to do."""


@dataclass(frozen=True)
class Recording:
    """One reference and one response, (frames,) each, at the sweep's rate and length.

    reference: what drove the rig, V or A; response: what came of it, m/s^2 or A. names: of both,
    for messages. limits: magnitudes at which the inputs of both clip, if known.
    correction: (bins,) what the instruments did to the response, to be divided out; None: nothing.
    delayed: the response comes later by some ms that nobody knows; polarity_known: else it may be
    upside down. drift_reach: half an interval of 95 %, as a share, of what is left between the two
    clocks.

    Raises
    ------
    IdentificationError
        Lengths differ, or samples are not finite.
    """

    sweep: Sweep
    reference: FloatArray
    response: FloatArray
    names: tuple[str, str] = ("drive", "acceleration")
    limits: tuple[float, float] = (float("inf"), float("inf"))
    correction: Any = None
    delayed: bool = False
    polarity_known: bool = True
    drift_reach: float = 0.0

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

    def inverted(self) -> "Recording":
        """The same with the response upside down."""
        return replace(self, response=-self.response)

    @cached_property
    def length(self) -> int:
        """Frames of the Fourier transform: the recording's, but for a few zeros."""
        return int(next_fast_len(self.sweep.frames, real=True))

    @cached_property
    def frequencies_hz(self) -> FloatArray:
        """(bins,) of the spectra."""
        return np.asarray(rfftfreq(self.length, 1.0 / self.sweep.samplerate))

    @cached_property
    def reference_spectrum(self) -> ComplexArray:
        """(bins,)."""
        return np.asarray(rfft(self.reference, self.length))

    @cached_property
    def response_spectrum(self) -> ComplexArray:
        """(bins,), with what the instruments did taken out."""
        spectrum = np.asarray(rfft(self.response, self.length))
        if self.correction is not None:
            # at 0 Hz a high-pass leaves nothing to divide by; the band does not go there
            correction = np.where(self.frequencies_hz > 0.0, self.correction, 1.0)
            spectrum = spectrum / correction
        return spectrum

    @cached_property
    def band(self) -> slice:
        """The bins inside the sweep, without the ends that are faded."""
        f, sweep = self.frequencies_hz, self.sweep
        low, high = np.searchsorted(f, [1.05 * sweep.low_hz, 0.97 * sweep.high_hz])
        return slice(int(low), int(high))

    def check(self) -> None:
        """Refuse a recording without signal, clipped, or of the wrong channel.

        Raises
        ------
        IdentificationError
            It says which, with the values, and what to do.
        """
        from device.identification.transfer import transfer

        lead = slice(0, round(0.9 * self.sweep.lead_frames))
        sounding = slice(self.sweep.lead_frames, None)
        for name, samples in zip(self.names, (self.reference, self.response), strict=True):
            noise, whole = float(np.std(samples[lead])), float(np.std(samples[sounding]))
            if whole <= _AUDIBLE * noise or not np.any(samples[sounding]):
                raise IdentificationError(
                    f"{name}: no signal, {whole:.3g} r.m.s. during the sweep and {noise:.3g} in "
                    "the silence before it; check power, cables and that channel, or raise the "
                    "level"
                )
        found = transfer(replace(self, correction=None))  # as it was read
        coherent = float(np.median(found.coherence))
        if coherent < 0.3:
            raise IdentificationError(
                f"{self.names[1]} does not follow the sweep: its coherence is {coherent:.2f}, it "
                "must be 0.3 or more; this is another channel, or noise: check which input it is"
            )
        gain = np.abs(found.response)
        spread = float(np.std(found.response) / np.mean(gain))
        if spread < 0.05:
            raise IdentificationError(
                f"{self.names[1]} is the {self.names[0]} itself, times {np.mean(gain):.3g}, to "
                f"{100 * spread:.1f} %; this is the wrong channel: check which input it is"
            )
        for name, samples, limit in zip(
            self.names, (self.reference, self.response), self.limits, strict=True
        ):
            if clipped := _clipped(samples, limit, plateaus=samples is self.response):
                raise IdentificationError(
                    f"{name}: {clipped} samples clip at {np.abs(samples).max():.4g}; lower the "
                    "level, or the gain of that input"
                )


def _clipped(samples: FloatArray, limit: float, *, plateaus: bool) -> int:
    """Samples at the limit, or, where it is not known, at a peak that crests are cut to."""
    magnitude = np.abs(samples)
    beyond = int(np.count_nonzero(magnitude >= _AT_THE_LIMIT * limit))
    if beyond or not plateaus:
        return beyond
    at_peak = magnitude >= magnitude.max() * (1.0 - 1e-4)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], at_peak.astype(np.int8), [0]])))
    runs = ends[1::2] - ends[::2]
    runs = runs[runs >= _CLIPPED_RUN]
    return int(runs.sum()) if len(runs) >= _CLIPPED_RUNS else 0
