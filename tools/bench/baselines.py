"""The baselines of `audioflinger_hook.baselines` as subjects of the benchmarks."""

from audioflinger_hook import baselines
from tools.bench.workbench import Subject

BASELINES = tuple(
    Subject(name.replace("octave-fold", "octave fold"), method)
    for name, method in baselines.BASELINES.items()
)

NULL_MODELS = (Subject("constant", baselines.CONSTANT),)
"""Methods that ignore the sound. If such a method does well on a measure, the measure says
little.
"""
