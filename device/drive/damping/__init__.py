"""Damping: less residual vibration, so that the seat stops when the signal stops.

| module          | holds                                                                        |
| --------------- | ---------------------------------------------------------------------------- |
| design.py       | `Damping`: a resonance inverse, as numbers                                    |
| residual.py     | what is left after a burst, for how long, and the volts that it took         |
| choice.py       | `choose_damping`: the best filter for a rig and the volts that it has        |
"""

from device.drive.damping.choice import choose_damping
from device.drive.damping.design import Damping

__all__ = ["Damping", "choose_damping"]
