"""A device, its configurations, interfaces and endpoints, decoded.

Sources: USB 2.0, 9.6; USB Audio 1.0, 4.6.1.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from device.usb.descriptors.audio_class import Entity, StreamFormat, StreamGeneral

_AUDIO = 0x01
_CONTROL, _STREAMING = 0x01, 0x02

UAC_OF_PROTOCOL = {0x00: 1, 0x20: 2, 0x30: 3}
"""Version of USB Audio by bInterfaceProtocol; Linux reads any other protocol as 1.0, too."""


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
    """An endpoint of an alternate setting.

    Usage and synchronisation are defined for isochronous endpoints only.
    """

    offset: int
    address: int
    transfer: Transfer
    synchronisation: Synchronisation
    usage: Usage
    packet_bytes: int  # largest number of bytes per (micro)frame
    interval: int
    synch_address: int  # of its feedback endpoint, 0 for none; 1.0 only

    @property
    def to_host(self) -> bool:
        """Whether it is an IN endpoint."""
        return bool(self.address & 0x80)


@dataclass(frozen=True, slots=True)
class Interface:
    """One alternate setting of an interface, with the descriptors that describe its sound."""

    offset: int  # bytes from the first of the configuration
    number: int
    alternate: int
    endpoint_count: int  # bNumEndpoints
    interface_class: int
    subclass: int
    protocol: int
    endpoints: tuple[Endpoint, ...] = ()  # those that follow
    entities: tuple[Entity, ...] = ()
    listed: tuple[int, ...] | None = None  # streaming interfaces in the header; None without one
    general: StreamGeneral | None = None
    format: StreamFormat | None = None

    @property
    def title(self) -> str:
        """Its name in problems."""
        return f"interface {self.number}.{self.alternate}"

    @property
    def uac(self) -> int:
        """The version of USB Audio, 1 to 3, of control and streaming interfaces; else 0."""
        is_audio = self.is_control or self.is_streaming
        return UAC_OF_PROTOCOL.get(self.protocol, 1) if is_audio else 0

    @property
    def is_control(self) -> bool:
        """Whether it describes an audio function."""
        return (self.interface_class, self.subclass) == (_AUDIO, _CONTROL)

    @property
    def is_streaming(self) -> bool:
        """Whether it carries sound."""
        return (self.interface_class, self.subclass) == (_AUDIO, _STREAMING)


@dataclass(frozen=True, slots=True)
class Configuration:
    """A decoded configuration.

    value: number that selects it.
    interface_count: bNumInterfaces.
    associations: numbers of the interfaces that form one function.
    interfaces: every alternate setting, in the device's order.
    problems: damage and contradictions, one line each.
    raw: all its bytes.
    """

    value: int
    interface_count: int
    associations: tuple[range, ...]
    interfaces: tuple[Interface, ...]
    problems: tuple[str, ...]
    raw: bytes

    @property
    def uac(self) -> int | None:
        """The highest version of USB Audio of its interfaces; None without audio."""
        return max((i.uac for i in self.interfaces if i.uac), default=None)
