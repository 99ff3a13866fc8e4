"""The transform: principal frequencies of sound, mapped to 20-220 Hz of vibration.

    intake -> bandpass -> spectrum -> principal, scaling --------> reference (unit by unit)
                              |
                              '---> analysis, scaling -> partials -> oscillators -> smoothing
                              loudness, follower,        limiter  '-> live (overlapped, early)
                              levels (also reference)

    haptic (what users hold) -> voices (NumPy: intake, then one transform a channel)
                             -> kernel (live, compiled: all of it in one call a block)
                             mixdown (before either, where voices are not the channels)

Pure: samples in, samples out; no clock, no I/O, no mixer.
"""

from audioflinger_hook.transform.arrays import FloatArray, Frames, IntArray
from audioflinger_hook.transform.haptic import Form, HapticTransform, Implementation
from audioflinger_hook.transform.kernel import kernel_warning
from audioflinger_hook.transform.parameters import TransformParameters

__all__ = [
    "FloatArray",
    "Form",
    "Frames",
    "HapticTransform",
    "Implementation",
    "IntArray",
    "TransformParameters",
    "kernel_warning",
]
