"""Protection of a rig by gain alone: excursion, current, coil temperature and level.

| module        | holds                                                                          |
| ------------- | ------------------------------------------------------------------------------ |
| limits.py     | the limits of a rig; `ProtectionStatus`                                        |
| bounding_models.py | the few models that bound every actuator that a rig may have        |
| drive_model.py | amplifier and actuator as one step from sample to sample                      |
| prediction.py | what a block of drive does to several linear models of the actuator            |
| governor.py   | the largest gain after which everything can still be stopped                   |
| thermal.py    | how warm coil and magnet are, and how much power they may have                 |
| protector.py  | the above, block by block, in the live path                                    |
"""

from device.drive.protection.limits import ProtectionStatus
from device.drive.protection.protector import Protector

__all__ = ["ProtectionStatus", "Protector"]
