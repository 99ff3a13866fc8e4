"""The transform computes vibration from the principal frequencies (main spectral peaks) of sound.

| module | contents |
| --- | --- |
| `haptic` | `HapticTransform`, the public class |
| `parameters` | parameters of the transform, with their ranges |
| `design/` | constants and tables of the live form |
| `native/` | the live form in C; tests/oracle has an implementation in NumPy |
| `reference` | the reference form: the paper's equations without changes |
| `input_stage`, `downmix`, `principal`, `mapping` | steps that both forms share |

The live form computes vibration in real time. Its terms: a hop (18 ms) is the interval between two
analyses. A tick (2 ms) is the interval between two searches for onsets. An onset is a sudden start
of sound. A partial is one sinusoid of the vibration.
"""

from audioflinger_hook.transform.arrays import FloatArray, Frames, IntArray
from audioflinger_hook.transform.haptic import Form, HapticTransform
from audioflinger_hook.transform.parameters import TransformParameters

TRANSFORM_VERSION = 3  # increases with each change of the vibration's samples

__all__ = [
    "TRANSFORM_VERSION",
    "FloatArray",
    "Form",
    "Frames",
    "HapticTransform",
    "IntArray",
    "TransformParameters",
]
