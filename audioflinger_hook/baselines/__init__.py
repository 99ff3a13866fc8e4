"""Simple methods of converting sound to vibration, for comparison with the transform.

    `band_pass`: the frequencies of the sound from 50 to 250 Hz.
    `envelope`: a vibration near 150 Hz with the envelope of the sound.
    `centroid`: one sine at the spectral centroid of the sound.
    `octave_fold`: two peaks of the spectrum, lowered by octaves.
    `constant`: the same sine for any sound.

Each of these modules has a class `Method`, a subclass of `stages.Baseline`. The benchmarks and
`cushion study` use them.
"""

from audioflinger_hook.baselines import band_pass, centroid, constant, envelope, octave_fold
from audioflinger_hook.baselines.stages import Baseline

__all__ = ["BASELINES", "Baseline"]

BASELINES: dict[str, type[Baseline]] = {
    "band-pass": band_pass.Method,
    "envelope": envelope.Method,
    "centroid": centroid.Method,
    "octave-fold": octave_fold.Method,
}

CONSTANT: type[Baseline] = constant.Method
