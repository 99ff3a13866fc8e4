"""Other methods from sound to vibration, in our own small implementations; none is tuned.

    band_pass                  the low part of the sound, unchanged
    envelope                   the sound's envelope, levelled, on a resonance
    centroid    -.             one sine at the spectral centroid
    octave_fold -'-- hops      two peaks, brought down by octaves
    constant                   a null model: the same strength whatever is heard

Each is the class `Method` of its module, see `stages.Baseline`.
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
"""What knows nothing of the sound; a measure that it does well on says nothing. The band-pass and
the envelope know one thing each."""
