"""Exposure: how much vibration a sitter has had today, as ISO 2631-1 and 2002/44/EC count it.

    drive -> decimator.py -> LinearActuator -> weighting.py -> dose.py
             6 kHz           acceleration      Wk              r.m.s., A(8), VDV
    `------------------------- ExposureMeter (meter.py) ---------------------'

    cap_gain (cap.py) is the optional gain that never lets a day's limit be passed.

It is information for the user of a cushion, not a measurement on the seat: acceleration is that
of the linear rung, and above 80 Hz, where the standard ends, the weighting is extrapolated.
"""

from device.drive.exposure.cap import cap_gain
from device.drive.exposure.dose import Dose, Exposure
from device.drive.exposure.meter import ExposureMeter
from device.drive.exposure.weighting import HIGHEST_HZ, wk_response, wk_sections

__all__ = [
    "HIGHEST_HZ",
    "Dose",
    "Exposure",
    "ExposureMeter",
    "cap_gain",
    "wk_response",
    "wk_sections",
]
