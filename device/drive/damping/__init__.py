"""Less residual vibration: what makes the seat stop when the signal stops.

Damping (design.py)   what to do, as numbers: a resonance inverse (inverse.py) or an input
                      shaper (shaper.py), at the amplifier's source impedance
Damper (damper.py)    does it live, block by block
burst_response        what is left after a burst, how long, for how many volts (residual.py)
choose_damping        the best one for a rig as it was identified, and for the volts there
                      are (choice.py)
FlatInverse           makes a rig that stiffens move as the linear one (flat_inverse.py)
large_burst_response  what is left after a burst at any level (large_bursts.py)
"""

from device.drive.damping.choice import Candidate, Choice, Uncertainty, choose_damping
from device.drive.damping.damper import Damper
from device.drive.damping.design import Damping, inverse_damping, no_damping, shaper_damping
from device.drive.damping.flat_inverse import FlatInverse
from device.drive.damping.inverse import Resonance, resonance_of
from device.drive.damping.large_bursts import LargeBurst, large_burst_response, undamped_large
from device.drive.damping.residual import BurstResponse, Residual, burst_response, undamped

__all__ = [
    "BurstResponse",
    "Candidate",
    "Choice",
    "Damper",
    "Damping",
    "FlatInverse",
    "LargeBurst",
    "Residual",
    "Resonance",
    "Uncertainty",
    "burst_response",
    "choose_damping",
    "inverse_damping",
    "large_burst_response",
    "no_damping",
    "resonance_of",
    "shaper_damping",
    "undamped",
    "undamped_large",
]
