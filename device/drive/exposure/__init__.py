"""Exposure: how much vibration a sitter has had today, after ISO 2631-1 and 2002/44/EC.

    drive -> Decimator -> LinearActuator -> dose.py
             6 kHz        acceleration      Wk, r.m.s., A(8), VDV
    `------------- ExposureMeter (meter.py) ------------'

`cap_gain` (dose.py) is the gain that keeps a day's dose under a limit.

The result informs the user of a cushion. It is no measurement on the seat: the acceleration comes
from the linear model, and above 80 Hz, where the standard ends, the weighting is extrapolated.
"""

from device.drive.exposure.dose import Exposure, cap_gain
from device.drive.exposure.meter import ExposureMeter

__all__ = ["Exposure", "ExposureMeter", "cap_gain"]
