"""All that a device, or a dump of one, holds: its device descriptor and every configuration."""

from __future__ import annotations

from dataclasses import dataclass

from device.usb.descriptors.configuration import Configuration
from device.usb.descriptors.problems import DescriptorError
from device.usb.descriptors.reading import parse_configuration
from device.usb.descriptors.standard import DeviceDescriptor, parse_device

_DEVICE = 0x01
CONFIGURATION_BYTES = 9


@dataclass(frozen=True, slots=True)
class WholeDevice:
    """device: None where the bytes begin with a configuration. rest: what is none, at the end."""

    device: DeviceDescriptor | None
    configurations: tuple[Configuration, ...]
    rest: bytes


def parse_whole(raw: bytes) -> WholeDevice:
    """What the bytes of a device say, as /sys has them, or a dump that begins anywhere in there.

    Forgiving, as `parse_configuration` is without strict.

    Raises
    ------
    DescriptorError
        They begin neither with a device nor with a configuration descriptor.
    """
    raw = bytes(raw)
    device = parse_device(raw) if raw[1:2] == bytes([_DEVICE]) else None
    rest = raw[len(device.raw) :] if device else raw
    configurations: list[Configuration] = []
    while rest:
        total = int.from_bytes(rest[2:4], "little")
        another = total >= CONFIGURATION_BYTES and rest[total : total + 2] == rest[:2]
        part = rest[:total] if another else rest
        try:
            configurations.append(parse_configuration(part))
        except DescriptorError:
            if not configurations and device is None:
                raise
            break
        rest = rest[len(part) :]
    return WholeDevice(device, tuple(configurations), rest)
