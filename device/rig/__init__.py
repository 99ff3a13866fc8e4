"""The simulated rig: every stage between the vibration signal and the seat.

| module | contents |
| --- | --- |
| parameters, rig | the parameters of a rig, modified rigs, and the TOML file of a rig |
| electronics, actuator | DAC and amplifier, accelerometer to DAQ; linear actuator |
| simulated_rig | all stages behind the interface `VibrationOutput` |
| co_energy, equations, thermal | non-linear actuator physics, seat, temperatures |
| adaptive_actuator | selects the cheapest sufficient actuator model for each block |
| model_record | the selected models, their cost and their true error |

Only the parameters are imported here: most other modules need SciPy, which loads slowly.
"""

from device.rig.parameters import ActuatorParameters
from device.rig.rig import CONSUMER, PAPER, Rig, read_rig, rig_by_name

__all__ = ["CONSUMER", "PAPER", "ActuatorParameters", "Rig", "read_rig", "rig_by_name"]
