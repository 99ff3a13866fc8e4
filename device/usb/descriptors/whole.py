"""A whole device, or a dump of one: its device descriptor and every configuration."""

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
    """A device with all its configurations.

    Attributes
    ----------
    device : DeviceDescriptor or None
        None where the bytes begin with a configuration.
    configurations : tuple of Configuration
        In the device's order.
    rest : bytes
        Undecoded bytes at the end.
    """

    device: DeviceDescriptor | None
    configurations: tuple[Configuration, ...]
    rest: bytes


def parse_whole(raw: bytes) -> WholeDevice:
    """Return the decoded bytes of a device, as forgiving as `parse_configuration`.

    Parameters
    ----------
    raw : bytes
        The content of /sys/.../descriptors, or a dump that begins with a configuration.

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
