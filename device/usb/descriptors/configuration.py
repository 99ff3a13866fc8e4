"""Classes for a decoded device, its configurations, interfaces and endpoints (USB 2.0, 9.6)."""

from dataclasses import dataclass
from enum import IntEnum

from device.usb.descriptors.audio_class import Entity, StreamFormat, StreamGeneral

_AUDIO = 0x01
_CONTROL, _STREAMING = 0x01, 0x02

UAC_OF_PROTOCOL = {0x00: 1, 0x20: 2, 0x30: 3}  # by bInterfaceProtocol; other values count as 1


# types of an endpoint; the last two are valid for isochronous endpoints only
Transfer = IntEnum("Transfer", "CONTROL ISOCHRONOUS BULK INTERRUPT", start=0)
Synchronisation = IntEnum("Synchronisation", "NONE ASYNCHRONOUS ADAPTIVE SYNCHRONOUS", start=0)
Usage = IntEnum("Usage", "DATA FEEDBACK IMPLICIT_FEEDBACK RESERVED", start=0)


@dataclass(frozen=True, slots=True)
class DeviceDescriptor:
    """A device. usb, release: versions of USB and of the device; 0x0210 means 2.10."""

    usb: int
    vendor_id: int
    product_id: int
    release: int
    configurations: int


@dataclass(frozen=True, slots=True)
class Endpoint:
    """An endpoint of an alternate setting."""

    offset: int
    address: int
    transfer: Transfer
    synchronisation: Synchronisation
    usage: Usage
    packet_bytes: int  # largest number of bytes per (micro)frame
    interval: int
    synch_address: int  # address of the feedback endpoint, 0 for none; 1.0 only

    @property
    def to_host(self) -> bool:
        """Whether the endpoint sends data to the host (IN)."""
        return bool(self.address & 0x80)


@dataclass(frozen=True, slots=True)
class Interface:
    """One alternate setting of an interface, with its decoded audio descriptors."""

    offset: int  # bytes from the start of the configuration
    number: int
    alternate: int
    endpoint_count: int  # bNumEndpoints
    interface_class: int
    subclass: int
    protocol: int
    endpoints: tuple[Endpoint, ...] = ()  # endpoints that the device describes
    entities: tuple[Entity, ...] = ()
    listed: tuple[int, ...] | None = None  # interface numbers in the header; None without header
    general: StreamGeneral | None = None
    format: StreamFormat | None = None

    @property
    def title(self) -> str:
        """The name of the alternate setting in error texts."""
        return f"interface {self.number}.{self.alternate}"

    @property
    def uac(self) -> int:
        """The version of USB Audio, 1 to 3, of an audio control or streaming interface; else 0."""
        is_audio = self.is_control or self.is_streaming
        return UAC_OF_PROTOCOL.get(self.protocol, 1) if is_audio else 0

    @property
    def is_control(self) -> bool:
        """Whether this is an audio control interface."""
        return (self.interface_class, self.subclass) == (_AUDIO, _CONTROL)

    @property
    def is_streaming(self) -> bool:
        """Whether this is an audio streaming interface."""
        return (self.interface_class, self.subclass) == (_AUDIO, _STREAMING)


@dataclass(frozen=True, slots=True)
class Configuration:
    """A decoded configuration.

    value: number that selects this configuration. interface_count: bNumInterfaces. associations:
    ranges of interface numbers; each range is one function. interfaces: all alternate settings, in
    the device's order. problems: errors and contradictions, one line each. raw: all bytes.
    """

    value: int
    interface_count: int
    associations: tuple[range, ...]
    interfaces: tuple[Interface, ...]
    problems: tuple[str, ...]
    raw: bytes

    @property
    def uac(self) -> int | None:
        """The highest version of USB Audio among the interfaces; None if none is for audio."""
        return max((i.uac for i in self.interfaces if i.uac), default=None)
