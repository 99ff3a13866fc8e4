"""The transform: principal frequencies of sound, mapped to 20-220 Hz of vibration.

| module | what it does |
| --- | --- |
| `haptic` | `HapticTransform`, which users hold; it calls the core |
| `parameters` | what shapes the vibration, and the ranges |
| `design/` | all numbers and tables of the live form |
| `native/` | the live form, in C; tests/oracle has it for whole sounds, in NumPy |
| `reference` | the paper's equations, literally, unit by unit |
| `input_stage`, `downmix`, `principal`, `mapping` | steps that several forms share |

Pure: samples in, samples out; no clock, no I/O, no mixer.
"""

from audioflinger_hook.transform.arrays import FloatArray, Frames, IntArray
from audioflinger_hook.transform.haptic import Form, HapticTransform
from audioflinger_hook.transform.parameters import TransformParameters

TRANSFORM_VERSION = 3
"""Raised whenever the bytes of a vibration change: results of older versions are made again."""

__all__ = [
    "TRANSFORM_VERSION",
    "FloatArray",
    "Form",
    "Frames",
    "HapticTransform",
    "IntArray",
    "TransformParameters",
]
