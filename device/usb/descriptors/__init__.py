"""Descriptors of USB Audio 1.0, 2.0 and 3.0: playable formats of a device, and errors in its data.

    dump.py           bytes from a raw file, text of lsusb -v or of this program, or a hex dump
    blocks.py         splits bytes into descriptors; collects error texts
    reading.py        decodes a device and its configurations
    configuration.py  a device, its configurations, interfaces and endpoints
    audio_class.py    terminals, units, clocks, formats and samplerates
    topology.py       paths of sound and clocks
    checks.py         contradictions in a configuration
    playback.py       formats that can be played

Pure functions of bytes. Unknown descriptors and the units of 3.0 are skipped.
"""

from device.usb.descriptors.audio_class import RateRange
from device.usb.descriptors.blocks import DescriptorError
from device.usb.descriptors.configuration import Configuration
from device.usb.descriptors.dump import hex_lines, parse_dump
from device.usb.descriptors.playback import PlaybackFormat, playback_formats
from device.usb.descriptors.reading import WholeDevice, parse_configuration, parse_whole

__all__ = [
    "Configuration",
    "DescriptorError",
    "PlaybackFormat",
    "RateRange",
    "WholeDevice",
    "hex_lines",
    "parse_configuration",
    "parse_dump",
    "parse_whole",
    "playback_formats",
]
