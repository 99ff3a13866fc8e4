"""Analysis of one unit (analysis window) by the transform's reference form: Figure 7."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.mapping import vibration_hz
from audioflinger_hook.transform.principal import Principals, Spectrum, magnitude
from audioflinger_hook.transform.reference import ReferenceTransform

PAPERS_UNIT = 39  # the paper's unit, 1.811 to 1.857 s, counted from 0 in units of 46.43 ms


@dataclass(frozen=True)
class UnitSequence:
    """A unit: its band-passed samples, amplitude spectrum and principal frequencies.

    samples: (N,). frequency_hz, amplitude: (bins,), 1 for a full-scale sine. principals: ascending
    in frequency. vibration_hz: (n,) vibration frequency of each principal.
    """

    start_s: float
    end_s: float
    samples: FloatArray
    frequency_hz: FloatArray
    amplitude: FloatArray
    principals: Principals
    vibration_hz: FloatArray


def unit_sequence(mono: FloatArray, samplerate: int, unit: int = PAPERS_UNIT) -> UnitSequence:
    """Return the analysis of one unit of a sound, (frames,), which must contain the whole unit."""
    parameters = TransformParameters()
    transform = ReferenceTransform(parameters, samplerate)
    samples = transform.cut(mono)[unit]
    spectrum = Spectrum.of(parameters, samplerate)
    found = transform.analyse(samples[None])
    unit_s = spectrum.window_frames / samplerate
    return UnitSequence(
        start_s=unit * unit_s,
        end_s=(unit + 1) * unit_s,
        samples=samples,
        frequency_hz=np.arange(spectrum.bins, dtype=np.float64) * spectrum.bin_hz,
        amplitude=magnitude(spectrum.transform(samples[None]))[0],
        principals=found,
        vibration_hz=vibration_hz(found.audio_hz, parameters),
    )
