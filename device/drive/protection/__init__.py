"""Protection of a rig by gain alone: excursion, current, coil temperature and level, as a design.

The core decides on gains (audioflinger_hook/core/drive/protection.c), by the tables of design.py.
"""

from device.drive.protection.limits import ProtectionStatus

__all__ = ["ProtectionStatus"]
