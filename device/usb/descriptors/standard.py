"""The device's own descriptor, and endpoints. Source: USB 2.0, 9.6; USB Audio 1.0, 4.6.1.1."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from device.usb.descriptors.blocks import DEVICE, Block, DescriptorError
from device.values import counted

DEVICE_BYTES = 18
ENDPOINT_BYTES = 7
AUDIO_ENDPOINT_BYTES = 9
"""Of USB Audio 1.0: bRefresh and bSynchAddress come last."""


class Transfer(IntEnum):
    """How an endpoint moves its bytes."""

    CONTROL = 0
    ISOCHRONOUS = 1
    BULK = 2
    INTERRUPT = 3


class Synchronisation(IntEnum):
    """The clock that an isochronous endpoint follows."""

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
class DeviceDescriptor:
    """A device. usb, release: binary-coded decimals, 0x0210 is 2.10."""

    usb: int
    vendor_id: int
    product_id: int
    release: int
    configurations: int


@dataclass(frozen=True, slots=True)
class Endpoint:
    """An endpoint of an alternate setting. synch_address: of its feedback, 0 for none.

    usage and synchronisation are defined for isochronous endpoints only.
    """

    offset: int
    address: int
    attributes: int
    max_packet: int
    interval: int
    synch_address: int

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
        """The clock that it follows."""
        return Synchronisation(self.attributes >> 2 & 3)

    @property
    def usage(self) -> Usage:
        """What it carries."""
        return Usage(self.attributes >> 4 & 3)

    @property
    def packet_bytes(self) -> int:
        """Largest bytes per (micro)frame: packet size times transactions (USB 2.0, 9.6.6)."""
        return (self.max_packet & 0x7FF) * (1 + (self.max_packet >> 11 & 3))


def parse_device(raw: bytes) -> DeviceDescriptor:
    """Return the device descriptor that the bytes begin with.

    DescriptorError: they do not begin with one of 18 bytes.
    """
    if len(raw) < DEVICE_BYTES or raw[0] < DEVICE_BYTES or raw[1] != DEVICE:
        raise DescriptorError(
            f"no device descriptor: {counted(len(raw), 'bytes')} there, "
            f"{raw[:2].hex(' ') or 'none'} first; needed: {DEVICE_BYTES} or more, 12 01 first"
        )

    def number(at: int) -> int:
        return int.from_bytes(raw[at : at + 2], "little")

    return DeviceDescriptor(number(2), number(8), number(10), number(12), raw[17])


def read_endpoint(block: Block) -> Endpoint | None:
    """Return the endpoint, None if the block is too short."""
    if not block.holds(ENDPOINT_BYTES):
        return None
    raw = block.raw
    synch_address = raw[8] if len(raw) >= AUDIO_ENDPOINT_BYTES else 0
    return Endpoint(block.offset, raw[2], raw[3], block.number(4, 2), raw[6], synch_address)
