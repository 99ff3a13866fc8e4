"""Designs of the processing for a device's actuators, and the device's channels.

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
