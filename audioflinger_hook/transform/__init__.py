"""The transform: principal frequencies of sound, mapped to 20-220 Hz of vibration.

    intake -> bandpass -> spectrum -> principal, scaling --------> reference (unit by unit)
                              |
                              '---> analysis, scaling -> partials -> oscillators -> smoothing
                                                         limiter  '-> live (overlapped, early)

`analysis` is compiled, as `_analysis`.

Pure: samples in, samples out; no clock, no I/O, no mixer.
"""

from audioflinger_hook.transform.haptic import Form, HapticTransform
from audioflinger_hook.transform.parameters import LIMITS, TransformParameters

__all__ = ["LIMITS", "Form", "HapticTransform", "TransformParameters"]
