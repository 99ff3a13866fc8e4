"""Parameters of the signal processing for a device's actuators, and maps of its channels.

The core (audioflinger_hook/core) processes the vibration with these parameters. The module `design`
is not imported here, because it needs SciPy, which loads slowly.
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
