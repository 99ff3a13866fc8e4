"""Everything after the vibration signal: outputs, sound cards, rigs and their simulation.

    vibration -> DAC -> power amplifier -> voice-coil actuator -> accelerometer, amplifier
                 `---------------------- rig/simulated_rig.py ----------------------'

Every target of vibration is a `VibrationOutput` (output.py), such as a WAV file (wav_output.py) or
the simulated rig. A file appears complete or not at all (atomic_file.py). Nothing here imports from
audioflinger_hook; both share errors.py and units.py.

`device.rig.simulated_rig` needs SciPy, which takes half a second to load: import it from there.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from device.errors import CushionError
    from device.rig import PAPER, Rig, rig_by_name

__all__ = ["PAPER", "CushionError", "Rig", "rig_by_name"]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: an error or an option needs no NumPy."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = "device.errors" if name == "CushionError" else "device.rig"
    return getattr(import_module(home), name)
