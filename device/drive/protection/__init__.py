"""Protection of a rig by gain alone: excursion, current, coil temperature and level, as a design.

| module        | holds                                                                          |
| ------------- | ------------------------------------------------------------------------------ |
| limits.py     | the limits of a rig; `ProtectionStatus`                                        |
| bounding_models.py | the few models that bound every actuator that a rig may have        |
| drive_model.py | amplifier and actuator as one step from sample to sample                      |
| prediction.py | what a block of drive does to several linear models of the actuator            |
| design.py     | all of it as numbers and tables for the core                                   |

The core decides on gains (audioflinger_hook/core/drive/protection.c).
"""

from device.drive.protection.limits import ProtectionStatus

__all__ = ["ProtectionStatus"]
