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
    from device.atomic_file import AtomicFile, write_bytes_atomically
    from device.errors import CushionError
    from device.output import VibrationOutput
    from device.rig import PAPER, Rig, rig_by_name
    from device.wav_output import WavOutput

__all__ = [
    "PAPER",
    "AtomicFile",
    "CushionError",
    "Rig",
    "VibrationOutput",
    "WavOutput",
    "rig_by_name",
    "write_bytes_atomically",
]

_HOMES = {
    "PAPER": "device.rig",
    "AtomicFile": "device.atomic_file",
    "CushionError": "device.errors",
    "Rig": "device.rig",
    "VibrationOutput": "device.output",
    "WavOutput": "device.wav_output",
    "rig_by_name": "device.rig",
    "write_bytes_atomically": "device.atomic_file",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: an error or an option needs no NumPy."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
