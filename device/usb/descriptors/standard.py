"""The descriptors that every USB device has: device, configuration, association, endpoint.

Source: USB 2.0, 9.6; interface associations: its ECN of 2003. The two bytes that audio endpoints
have more: USB Audio 1.0, 4.6.1.1. Lengths are the least; more bytes are kept in `raw`.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

from device.usb.descriptors.blocks import Block, Descriptor
from device.usb.descriptors.problems import DescriptorError, Findings

DEVICE, CONFIGURATION, INTERFACE, ENDPOINT, ASSOCIATION = 0x01, 0x02, 0x04, 0x05, 0x0B
COMPANION = 0x30

DEVICE_BYTES = 18
CONFIGURATION_BYTES = 9
ASSOCIATION_BYTES = 8
INTERFACE_BYTES = 9
ENDPOINT_BYTES = 7
AUDIO_ENDPOINT_BYTES = 9

_MA_PER_UNIT = 2
_ISOCHRONOUS_INTERVALS = range(1, 17)


class Transfer(IntEnum):
    """How an endpoint moves its bytes."""

    CONTROL = 0
    ISOCHRONOUS = 1
    BULK = 2
    INTERRUPT = 3


class Synchronisation(IntEnum):
    """Whose clock an isochronous endpoint follows."""

    NONE = 0
    ASYNCHRONOUS = 1
    ADAPTIVE = 2
    SYNCHRONOUS = 3


class Usage(IntEnum):
    """What an isochronous endpoint carries."""

    DATA = 0
    FEEDBACK = 1
    IMPLICIT_FEEDBACK = 2
    RESERVED = 3


@dataclass(frozen=True, slots=True)
class DeviceDescriptor(Descriptor):
    """The device. usb, release: binary-coded decimals, 0x0200 is 2.0; string indices: 0 is none."""

    usb: int
    device_class: int
    subclass: int
    protocol: int
    control_packet_bytes: int
    vendor_id: int
    product_id: int
    release: int
    manufacturer_string: int
    product_string: int
    serial_string: int
    configurations: int

    kind: ClassVar[str] = "device"


@dataclass(frozen=True, slots=True)
class ConfigurationHeader(Descriptor):
    """The configuration's own descriptor.

    total_bytes: wTotalLength; interfaces: how many it says there are; value: the number that
    selects it. max_power_ma: from the bus.
    """

    total_bytes: int
    interfaces: int
    value: int
    string_index: int
    self_powered: bool
    remote_wakeup: bool
    max_power_ma: int

    kind: ClassVar[str] = "configuration"


@dataclass(frozen=True, slots=True)
class InterfaceAssociation(Descriptor):
    """Interfaces that are one function: `interfaces` of them, from number `first` on."""

    first: int
    interfaces: int
    function_class: int
    subclass: int
    protocol: int
    string_index: int


@dataclass(frozen=True, slots=True)
class Endpoint(Descriptor):
    """An endpoint of an alternate setting.

    address: bit 7 is the direction (1: to the host); attributes, max_packet: as they stand.
    interval: bInterval. refresh, synch_address: of audio endpoints of 9 bytes, else None.
    descriptors: what follows it, class-specific endpoint descriptors for example.
    """

    address: int
    attributes: int
    max_packet: int
    interval: int
    refresh: int | None
    synch_address: int | None
    descriptors: tuple[Descriptor, ...] = ()

    @property
    def title(self) -> str:
        """What a person calls it."""
        return f"endpoint 0x{self.address:02x}"

    @property
    def to_host(self) -> bool:
        """Whether it is an IN endpoint."""
        return bool(self.address & 0x80)

    @property
    def transfer(self) -> Transfer:
        """How it moves its bytes."""
        return Transfer(self.attributes & 3)

    @property
    def synchronisation(self) -> Synchronisation:
        """Whose clock it follows; means something of isochronous ones only."""
        return Synchronisation(self.attributes >> 2 & 3)

    @property
    def usage(self) -> Usage:
        """What it carries; means something of isochronous ones only."""
        return Usage(self.attributes >> 4 & 3)

    def interval_us(self, full_speed: bool) -> int | None:
        """Microseconds between two packets (USB 2.0, 9.6.6); None without a fixed time."""
        if self.transfer not in (Transfer.ISOCHRONOUS, Transfer.INTERRUPT) or not self.interval:
            return None
        if full_speed and self.transfer is Transfer.INTERRUPT:
            return 1_000 * self.interval
        return (1_000 if full_speed else 125) << (min(self.interval, 16) - 1)

    @property
    def packet_bytes(self) -> int:
        """Largest bytes per (micro)frame: packet size times transactions (USB 2.0, 9.6.6)."""
        return (self.max_packet & 0x7FF) * (1 + (self.max_packet >> 11 & 3))


def _first(raw: bytes, name: str, kind: int, least_bytes: int) -> Block:
    """Return the descriptor that the bytes begin with. DescriptorError: it is another."""
    length = raw[0] if raw else 0
    block = Block(0, bytes(raw[:length]), name, Findings(strict=True))
    if len(block.raw) < least_bytes:
        block.note(f"bLength is {length} of {len(raw)} bytes", f"{least_bytes} bytes or more")
    if block.type != kind:
        block.note(f"bDescriptorType is 0x{block.type:02x}", f"0x{kind:02x}")
    return block


def parse_device(raw: bytes) -> DeviceDescriptor:
    """Return the device descriptor at the beginning of the bytes.

    Parameters
    ----------
    raw : bytes
        18 bytes or more.

    Raises
    ------
    DescriptorError
        They do not begin with a device descriptor.
    """
    block = _first(raw, "device", DEVICE, DEVICE_BYTES)
    return DeviceDescriptor(0, block.raw, *struct.unpack_from("<H4B3H4B", block.raw, 2))


def read_header(raw: bytes) -> ConfigurationHeader:
    """The configuration descriptor that the bytes begin with.

    DescriptorError: they do not begin with one of at least 9 bytes.
    """
    if len(raw) >= DEVICE_BYTES <= raw[0] and raw[1] == DEVICE:
        raise DescriptorError(
            "offset 0, device: a device descriptor; allowed: a configuration descriptor; "
            f"leave out the first {raw[0]} bytes"
        )
    block = _first(raw, "configuration", CONFIGURATION, CONFIGURATION_BYTES)
    fields = block.raw
    return ConfigurationHeader(
        offset=0,
        raw=fields,
        total_bytes=block.u16(2),
        interfaces=fields[4],
        value=fields[5],
        string_index=fields[6],
        self_powered=bool(fields[7] & 0x40),
        remote_wakeup=bool(fields[7] & 0x20),
        max_power_ma=fields[8] * _MA_PER_UNIT,
    )


def read_association(block: Block) -> InterfaceAssociation | None:
    """The interface association, None if it is too short."""
    if not block.holds(ASSOCIATION_BYTES):
        return None
    return InterfaceAssociation(block.offset, block.raw, *block.raw[2:ASSOCIATION_BYTES])


def read_endpoint(block: Block) -> Endpoint | None:
    """The endpoint, without the descriptors after it; None if it is too short."""
    if not block.holds(ENDPOINT_BYTES):
        return None
    fields = block.raw
    audio = len(fields) >= AUDIO_ENDPOINT_BYTES
    endpoint = Endpoint(
        offset=block.offset,
        raw=fields,
        address=fields[2],
        attributes=fields[3],
        max_packet=block.u16(4),
        interval=fields[6],
        refresh=fields[7] if audio else None,
        synch_address=fields[8] if audio else None,
    )
    block.name = endpoint.title
    if not endpoint.address & 0x0F:
        block.note(f"bEndpointAddress is 0x{endpoint.address:02x}", "a number of 1 to 15")
    if endpoint.transfer is Transfer.ISOCHRONOUS:
        if endpoint.interval not in _ISOCHRONOUS_INTERVALS:
            block.note(f"bInterval is {endpoint.interval}", "1 to 16")
        if endpoint.usage is Usage.RESERVED:
            block.note("the usage type is 3", "0 (data), 1 (feedback) or 2 (implicit feedback)")
    return endpoint
