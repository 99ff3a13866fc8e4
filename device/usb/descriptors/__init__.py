"""Descriptors of USB Audio 1.0 and 2.0, and what 3.0 shares with them, decoded from raw bytes.

    dump.py             bytes from a raw file, lsusb -v, a description or a hex dump
    hexdump.py          bytes from a hex dump
    blocks.py           bytes split into descriptors
    problems.py         violations of the specifications, with their places
    standard.py         device, configuration, association, endpoint
    entities.py         terminals, units, clocks (read by control.py)
    streaming.py        formats, sample rates, streaming endpoints
    configuration.py    a configuration as a tree (built by reading.py)
    checks.py           contradictions in a configuration
    topology.py         paths of sound and clocks
    playback.py         formats that can be played
    text.py, names.py   descriptions for people

Pure functions of bytes. Units of USB Audio 3.0 and unknown descriptors keep their bytes. Volumes
are in 1/256 dB.
"""

from device.usb.descriptors.configuration import Configuration
from device.usb.descriptors.dump import parse_dump
from device.usb.descriptors.hexdump import parse_hex
from device.usb.descriptors.playback import PlaybackFormat, playback_formats
from device.usb.descriptors.problems import DescriptorError
from device.usb.descriptors.reading import WholeDevice, parse_configuration, parse_whole
from device.usb.descriptors.standard import parse_device
from device.usb.descriptors.streaming import RateRange
from device.usb.descriptors.text import describe, hex_lines

__all__ = [
    "Configuration",
    "DescriptorError",
    "PlaybackFormat",
    "RateRange",
    "WholeDevice",
    "describe",
    "hex_lines",
    "parse_configuration",
    "parse_device",
    "parse_dump",
    "parse_hex",
    "parse_whole",
    "playback_formats",
]
