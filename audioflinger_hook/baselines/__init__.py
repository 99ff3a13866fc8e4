"""Simple methods of converting sound to vibration, for comparison with the transform.

Each module has a class `Method`, a subclass of `stages.Baseline`.
"""

from audioflinger_hook.baselines import band_pass, centroid, envelope, octave_fold
from audioflinger_hook.baselines.stages import Baseline

BASELINES: dict[str, type[Baseline]] = {
    "band-pass": band_pass.Method,
    "envelope": envelope.Method,
    "centroid": centroid.Method,
    "octave-fold": octave_fold.Method,
}
