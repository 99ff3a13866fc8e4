"""The simulated rig: every stage between the vibration signal and the seat.

| module | holds |
| --- | --- |
| parameters, rig | what a rig is, variants of it, and its TOML file |
| electronics, actuator | DAC and amplifier, accelerometer to DAQ; linear actuator |
| simulated_rig | all stages behind `VibrationOutput` |
| co_energy, equations, thermal | the physics beyond the linear actuator, and the seat |
| adaptive_actuator | the cheapest model that suffices, block by block |
| model_record | which model ran, its cost and its true error |

Only the descriptions are imported here, because SciPy takes half a second to load.
"""

from device.rig.parameters import ActuatorParameters
from device.rig.rig import CONSUMER, PAPER, Rig, read_rig, rig_by_name

__all__ = ["CONSUMER", "PAPER", "ActuatorParameters", "Rig", "read_rig", "rig_by_name"]
