"""One unit sequence of the recording as the transform's reference form sees it: Figure 7."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.mapping import vibration_hz
from audioflinger_hook.transform.principal import Principals, Spectrum, magnitude
from audioflinger_hook.transform.reference import ReferenceTransform

PAPERS_UNIT = 39
"""From 0: with 46.43 ms each it is the paper's, 1.811 to 1.857 s."""


@dataclass(frozen=True)
class UnitSequence:
    """A unit: its band-passed samples, its amplitude spectrum and what is principal in it.

    start_s, end_s; samples: (N,); frequency_hz, amplitude: (bins,), a full-scale sine has 1;
    principals: ascending in frequency; vibration_hz: (n,), what each one is felt as.
    """

    start_s: float
    end_s: float
    samples: FloatArray
    frequency_hz: FloatArray
    amplitude: FloatArray
    principals: Principals
    vibration_hz: FloatArray


def unit_sequence(mono: FloatArray, samplerate: int, unit: int = PAPERS_UNIT) -> UnitSequence:
    """The unit with that number of sound (frames,), full scale 1; it must be complete."""
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
