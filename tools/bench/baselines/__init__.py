"""Simple methods of converting sound to vibration, for comparison with the transform.

    `band_pass`: the frequencies of the sound from 50 to 250 Hz.
    `envelope`: a vibration near 150 Hz with the envelope of the sound.
    `centroid`: one sine at the spectral centroid of the sound.
    `octave_fold`: two peaks of the spectrum, lowered by octaves.
    `constant`: the same sine for any sound.

Each of these modules has a class `Method`, a subclass of `stages.Baseline`.
"""

from __future__ import annotations

from tools.bench.baselines import band_pass, centroid, constant, envelope, octave_fold
from tools.bench.workbench import Subject

__all__ = ["BASELINES", "NULL_MODELS"]

BASELINES = (
    Subject("band-pass", band_pass.Method),
    Subject("envelope", envelope.Method),
    Subject("centroid", centroid.Method),
    Subject("octave fold", octave_fold.Method),
)

NULL_MODELS = (Subject("constant", constant.Method),)
"""Methods that ignore the sound. If such a method does well on a measure, the measure says
little.
"""
