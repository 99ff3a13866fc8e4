"""Protection ahead of time: excursion, current, coil temperature and level, by gain alone.

Limits (limits.py)            what the rig must not exceed
Chain (chain.py)              amplifier and actuator as one step from sample to sample
Prediction (prediction.py)    what a block of drive does to a stack of linear models
Governor (governor.py)        the largest gain after which everything can still be stopped
CoilTemperature (thermal.py)  how warm coil and magnet are, and what power they may have
Protector (protector.py)      all of it in the live path, block by block
ProtectionStatus (status.py)  what it did, for display
"""

from device.drive.protection.limits import Limits, limits_of
from device.drive.protection.protector import Protector
from device.drive.protection.status import ProtectionStatus
from device.drive.protection.thermal import CoilTemperature

__all__ = [
    "CoilTemperature",
    "Limits",
    "ProtectionStatus",
    "Protector",
    "limits_of",
]
