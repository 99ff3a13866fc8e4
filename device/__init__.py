"""Everything behind the vibration signal: where it goes, and what it does there.

    vibration -> DAC -> power amplifier -> voice-coil actuator -> accelerometer, amplifier
                 `---------------------- rig/, with its twin.py ----------------------'

Anything that takes vibration is a `VibrationOutput` (output.py): a WAV file (wav_output.py) and
the twin, the simulated rig, today; sound cards take the same place. Files appear whole or not at
all (atomic_file.py). Nothing here imports from audioflinger_hook; both share errors.py, units.py.

The twin is imported from device.rig.twin: it needs SciPy, which takes half a second to load, and
whoever wants only an error or a file should not wait for it.
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
