"""Designs of the processing for a device's actuators, and the device's channels.

| module                | holds                                                                |
| --------------------- | -------------------------------------------------------------------- |
| settings.py           | what a user may choose for one actuator                              |
| design.py             | `DriveDesign`: damping, protection and exposure meter of one rig     |
| damping, protection, exposure | their parts                                                  |
| safety.py             | temperatures and doses that outlive a process                        |
| channel_map.py        | which actuator each channel of a device plays                        |
| channel_positions.py  | channel maps for a sink of a sound server                            |
| channel_router.py     | routes actuators to the channels of an open output                   |
| outputs.py            | outputs behind a drive, and without the latency                      |

The core drives by these designs (audioflinger_hook/core). `design` needs SciPy, which loads slowly:
import it from its module.
"""

from device.drive.channel_map import ChannelMap, Wiring, channels_needed
from device.drive.settings import (
    POLARITIES,
    SOURCES,
    ActuatorSettings,
    sources_of,
    wiring_of,
    wiring_refusals,
)

__all__ = [
    "POLARITIES",
    "SOURCES",
    "ActuatorSettings",
    "ChannelMap",
    "Wiring",
    "channels_needed",
    "sources_of",
    "wiring_of",
    "wiring_refusals",
]
