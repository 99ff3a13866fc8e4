"""Several actuators: each its own vibration, rig, level, polarity, delay and channels.

    settings.py     what a user may choose of one actuator
    past.py         the vibration of the last half second, read at any delay
    path.py         one actuator's way: source, delay, level and polarity, changed without a click
    actuators.py    all of them as one processor: vibration of the sources in, of the actuators out
    channel_map.py  which actuator each channel of a device drives
    spread.py       that map in the live path, changed without a click

Pure: no I/O, no clock. `driven.py` and `twins.py` are the outputs of files and of the simulated
rigs; they need SciPy, and so does `actuators.py`: import them from there.
"""

from device.drive.channel_map import ChannelMap, Wiring, channels_needed
from device.drive.settings import (
    POLARITIES,
    SOURCES,
    ActuatorSettings,
    problems,
    problems_together,
    sources_of,
    wiring_of,
)
from device.drive.spread import Spread

__all__ = [
    "POLARITIES",
    "SOURCES",
    "ActuatorSettings",
    "ChannelMap",
    "Spread",
    "Wiring",
    "channels_needed",
    "problems",
    "problems_together",
    "sources_of",
    "wiring_of",
]
