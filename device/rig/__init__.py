"""The simulated rig: every stage between the vibration signal and the seat.

    dac.py -> amplifier.py -> actuator.py -> instruments.py
    `---- twin.py ----'       |- linear_system.py
                              adaptive.py, report.py          rig.py describes all: rig_file.py
                              |- choice.py, hand_over.py    reads paper.toml, consumer.toml or
                              |- node_grid.py, levels.py     another, within limits.py and without
                              |  collocation.py             contradictions.py
                              |  passive_step.py
                              `- equations.py, co_energy.py, shapes.py, thermal.py

The linear actuator is one class; whoever needs more of its physics takes the adaptive one, which
adds what a tolerance asks for: from shapes.py, through energies, to equations and their solutions.

Here only the descriptions are imported: the stages need SciPy, which takes half a second to load,
and whoever wants a name or an error should not wait for it.
"""

from device.rig.parameters import (
    AccelerometerParameters,
    ActuatorParameters,
    AmplifierParameters,
    ConditioningParameters,
    DacParameters,
    DaqParameters,
    LargeSignalParameters,
    SeatParameters,
    ThermalParameters,
)
from device.rig.rig import Rig, Source
from device.rig.rig_file import CONSUMER, PAPER, read_rig, rig_by_name

__all__ = [
    "CONSUMER",
    "PAPER",
    "AccelerometerParameters",
    "ActuatorParameters",
    "AmplifierParameters",
    "ConditioningParameters",
    "DacParameters",
    "DaqParameters",
    "LargeSignalParameters",
    "Rig",
    "SeatParameters",
    "Source",
    "ThermalParameters",
    "read_rig",
    "rig_by_name",
]
