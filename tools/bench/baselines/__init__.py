"""Other methods from sound to vibration, in our own small implementations; none is tuned.

    band_pass                  the low part of the sound, unchanged
    envelope                   the sound's envelope, levelled, on a resonance
    centroid    -.             one sine at the spectral centroid
    octave_fold -'-- hops      two peaks, brought down by octaves

Each is the class `Method` of its module, see `stages.Baseline`.
"""

from __future__ import annotations

from tools.bench.baselines import band_pass, centroid, envelope, octave_fold
from tools.bench.workbench import Subject

__all__ = ["BASELINES"]

BASELINES = (
    Subject("band-pass", band_pass.Method),
    Subject("envelope", envelope.Method),
    Subject("centroid", centroid.Method),
    Subject("octave fold", octave_fold.Method),
)
