"""Everything behind the vibration signal: where it goes, and what it does there.

    vibration -> DAC -> power amplifier -> voice-coil actuator -> accelerometer, amplifier
                 `---------------------- rig/simulated_rig.py ----------------------'

Anything that takes vibration is a `VibrationOutput` (output.py), such as a WAV file (wav_output.py)
or the simulated rig. Files appear whole or not at all (atomic_file.py). Nothing here imports from
audioflinger_hook; both share errors.py and units.py.

`device.rig.simulated_rig` needs SciPy, which takes half a second to load: import it from there.
"""

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
