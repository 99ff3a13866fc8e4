"""A decoded configuration: its interfaces, and what each of them contains."""

from __future__ import annotations

from dataclasses import dataclass

from device.usb.descriptors.entities import Entity
from device.usb.descriptors.standard import Endpoint
from device.usb.descriptors.streaming import StreamFormat, StreamGeneral

AUDIO = 0x01
CONTROL, STREAMING = 0x01, 0x02

UAC_OF_PROTOCOL = {0x00: 1, 0x20: 2, 0x30: 3}
"""Version of USB Audio by bInterfaceProtocol; Linux reads any other protocol as 1.0, too."""


@dataclass(frozen=True, slots=True)
class Interface:
    """One alternate setting of an interface, with the descriptors that describe its sound.

    Attributes
    ----------
    offset : int
        Bytes from the first of the configuration.
    number, alternate, endpoint_count, interface_class, subclass, protocol : int
        Fields of the descriptor; endpoint_count is bNumEndpoints.
    endpoints : tuple of Endpoint
        The endpoints that follow.
    entities : tuple of Entity
        Terminals, units and clocks of a control interface.
    listed : tuple of int or None
        Streaming interfaces in the header of a control interface; None without a header.
    general, format : StreamGeneral, StreamFormat or None
        The first of a streaming interface.
    """

    offset: int
    number: int
    alternate: int
    endpoint_count: int
    interface_class: int
    subclass: int
    protocol: int
    endpoints: tuple[Endpoint, ...] = ()
    entities: tuple[Entity, ...] = ()
    listed: tuple[int, ...] | None = None
    general: StreamGeneral | None = None
    format: StreamFormat | None = None

    @property
    def title(self) -> str:
        """Its name in problems."""
        return f"interface {self.number}.{self.alternate}"

    @property
    def uac(self) -> int | None:
        """The version of USB Audio, 1 to 3, of control and streaming interfaces; else None."""
        if self.is_control or self.is_streaming:
            return UAC_OF_PROTOCOL.get(self.protocol, 1)
        return None

    @property
    def is_control(self) -> bool:
        """Whether it describes an audio function."""
        return (self.interface_class, self.subclass) == (AUDIO, CONTROL)

    @property
    def is_streaming(self) -> bool:
        """Whether it carries sound."""
        return (self.interface_class, self.subclass) == (AUDIO, STREAMING)


@dataclass(frozen=True, slots=True)
class Configuration:
    """A decoded configuration.

    Attributes
    ----------
    value : int
        Number that selects it.
    interface_count : int
        bNumInterfaces.
    associations : tuple of range
        Numbers of interfaces that form one function.
    interfaces : tuple of Interface
        Every alternate setting, in the device's order.
    problems : tuple of str
        Damage and contradictions, one line each.
    raw : bytes
        All its bytes.
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
        return max((i.uac for i in self.interfaces if i.uac is not None), default=None)
