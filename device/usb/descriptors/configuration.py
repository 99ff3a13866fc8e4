"""A configuration as a tree: interfaces with their alternate settings, endpoints, descriptors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from device.usb.descriptors.blocks import Block, Descriptor
from device.usb.descriptors.entities import ControlHeader, Entity
from device.usb.descriptors.problems import Problem
from device.usb.descriptors.standard import (
    COMPANION,
    INTERFACE_BYTES,
    ConfigurationHeader,
    Endpoint,
    InterfaceAssociation,
)
from device.usb.descriptors.streaming import StreamFormat, StreamGeneral, StreamGeneral3

AUDIO = 0x01
CONTROL, STREAMING, MIDI = 0x01, 0x02, 0x03

UAC_OF_PROTOCOL = {0x00: 1, 0x20: 2, 0x30: 3}
"""The version of USB Audio; what is read as 1.0 by any other protocol is so in Linux too."""


@dataclass(frozen=True, slots=True)
class Interface(Descriptor):
    """One alternate setting of an interface.

    endpoint_count: how many it says there are; descriptors: its class-specific and unknown ones,
    as they came; endpoints: each with those that follow it.
    """

    number: int
    alternate: int
    endpoint_count: int
    interface_class: int
    subclass: int
    protocol: int
    string_index: int
    descriptors: tuple[Descriptor, ...] = ()
    endpoints: tuple[Endpoint, ...] = ()

    @property
    def title(self) -> str:
        """What a person calls it."""
        return f"interface {self.number}.{self.alternate}"

    @property
    def uac(self) -> int | None:
        """The version of USB Audio, 1 to 3, of control and streaming interfaces; else None."""
        if self.interface_class != AUDIO or self.subclass not in (CONTROL, STREAMING):
            return None
        return UAC_OF_PROTOCOL.get(self.protocol, 1)

    @property
    def is_control(self) -> bool:
        """Whether it is the head of an audio function."""
        return self.interface_class == AUDIO and self.subclass == CONTROL

    @property
    def is_streaming(self) -> bool:
        """Whether sound passes it."""
        return self.interface_class == AUDIO and self.subclass == STREAMING

    @property
    def header(self) -> ControlHeader | None:
        """The first audio control header."""
        return next((d for d in self.descriptors if isinstance(d, ControlHeader)), None)

    @property
    def entities(self) -> tuple[Entity, ...]:
        """Its terminals, units and clocks."""
        return tuple(d for d in self.descriptors if isinstance(d, Entity))

    @property
    def general(self) -> StreamGeneral | None:
        """The first descriptor of the format of the stream."""
        return next((d for d in self.descriptors if isinstance(d, StreamGeneral)), None)

    @property
    def general_3(self) -> StreamGeneral3 | None:
        """The first descriptor of the format of a stream of 3.0."""
        return next((d for d in self.descriptors if isinstance(d, StreamGeneral3)), None)

    @property
    def format(self) -> StreamFormat | None:
        """The first format of type I."""
        return next((d for d in self.descriptors if isinstance(d, StreamFormat)), None)


@dataclass(frozen=True, slots=True)
class Configuration:
    """A decoded configuration.

    Attributes
    ----------
    header : ConfigurationHeader
        Its first descriptor.
    associations : tuple of InterfaceAssociation
        Groups of interfaces.
    interfaces : tuple of Interface
        Every alternate setting, in the device's order.
    others : tuple of Descriptor
        Descriptors outside any interface.
    rest : bytes
        Bytes behind the last readable descriptor.
    problems : tuple of Problem
        Violations of the specifications; none in strict mode.
    """

    header: ConfigurationHeader
    associations: tuple[InterfaceAssociation, ...]
    interfaces: tuple[Interface, ...]
    others: tuple[Descriptor, ...]
    rest: bytes
    problems: tuple[Problem, ...]

    @property
    def uac(self) -> int | None:
        """The highest version of USB Audio of its interfaces; None without audio."""
        return max((i.uac for i in self.interfaces if i.uac is not None), default=None)

    @property
    def is_super_speed(self) -> bool:
        """Whether it is of a device that runs at SuperSpeed: every endpoint has a companion."""
        endpoints = (endpoint for interface in self.interfaces for endpoint in interface.endpoints)
        of_endpoints = (other for endpoint in endpoints for other in endpoint.descriptors)
        return any(other.raw[1] == COMPANION for other in of_endpoints)

    def raw(self) -> bytes:
        """The bytes that it was read from."""
        return b"".join(descriptor.raw for descriptor in self.descriptors()) + self.rest

    def descriptors(self) -> Iterator[Descriptor]:
        """Every descriptor, the header first, the others by offset."""
        found: list[Descriptor] = [*self.associations, *self.others]
        for interface in self.interfaces:
            found += [interface, *interface.descriptors]
            for endpoint in interface.endpoints:
                found += [endpoint, *endpoint.descriptors]
        yield self.header
        yield from sorted(found, key=lambda descriptor: descriptor.offset)


def read_interface(block: Block) -> Interface | None:
    """The interface, without its endpoints and descriptors; None if it is too short."""
    if not block.holds(INTERFACE_BYTES):
        return None
    interface = Interface(block.offset, block.raw, *block.raw[2:INTERFACE_BYTES])
    block.name = interface.title
    if interface.uac is not None and interface.protocol not in UAC_OF_PROTOCOL:
        block.note(
            f"bInterfaceProtocol is 0x{interface.protocol:02x}, read as USB Audio 1.0",
            "0x00 (1.0), 0x20 (2.0) or 0x30 (3.0)",
        )
    return interface
