"""The transform: principal frequencies of sound, mapped to 20-220 Hz of vibration.

    input_stage -> spectrum -> principal, mapping -> reference/  (unit by unit)
                      '-----> live/                              (overlapped, early)

| module | what it does |
| --- | --- |
| `haptic` | `HapticTransform`, which users hold; it calls the kernel |
| `parameters` | what shapes the vibration, and the ranges |
| `design/` | all numbers and tables of the live form |
| `native/` | the live form compiled: one call a block |
| `live/` | the live form in NumPy |
| `reference/` | the paper's equations, literally |
| `channel_bank` | the NumPy implementations, one for each channel |
| `input_stage`, `downmix`, `spectrum`, `principal`, `mapping` | steps that several forms share |

Pure: samples in, samples out; no clock, no I/O, no mixer.
"""

from audioflinger_hook.transform.arrays import FloatArray, Frames, IntArray
from audioflinger_hook.transform.haptic import Form, HapticTransform, Implementation, kernel_warning
from audioflinger_hook.transform.parameters import TransformParameters

TRANSFORM_VERSION = 2
"""Raised whenever the bytes of a vibration change: results of older versions are made again."""

__all__ = [
    "TRANSFORM_VERSION",
    "FloatArray",
    "Form",
    "Frames",
    "HapticTransform",
    "Implementation",
    "IntArray",
    "TransformParameters",
    "kernel_warning",
]
