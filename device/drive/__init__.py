"""The drive path: from the vibration of the sources to the channels of a device.

| module                | holds                                                                |
| --------------------- | -------------------------------------------------------------------- |
| drive.py              | `Drive`: vibration of the sources in, what each actuator plays out;  |
|                       | `ChannelRouter`: routes this to the channels of a device             |
| actuator_feed.py      | the last half second; one actuator's source, delay, level, polarity  |
| rig_processor.py      | damping, protection and exposure meter of one rig                    |
| channel_map.py        | which actuator each channel of a device plays                        |
| channel_positions.py  | channel maps for a sink of a sound server                            |
| outputs.py            | outputs behind a drive, and without the latency                      |
| settings.py           | what a user may choose for one actuator                              |
| damping, protection, exposure | what is done for a rig                                       |

`drive` and `rig_processor` need SciPy, which loads slowly: import them from their modules.
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
