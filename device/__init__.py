"""Vibration outputs, sound cards, and rigs (models of amplifier, actuator and seat).

    vibration -> DAC -> power amplifier -> voice-coil actuator -> accelerometer, amplifier
                 `---------------------- rig/simulated_rig.py ----------------------'

`VibrationOutput` (output.py) is the interface of all vibration outputs, such as WAV files
(wav_output.py) and the simulated rig. This package imports nothing from audioflinger_hook.

No `__init__.py` imports `device.rig.simulated_rig`, because it needs SciPy, which loads slowly.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from device.errors import CushionError
    from device.rig import PAPER, Rig, rig_by_name

__all__ = ["PAPER", "CushionError", "Rig", "rig_by_name"]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use, so that the package itself loads without NumPy."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("device.errors" if name == "CushionError" else "device.rig"), name)
