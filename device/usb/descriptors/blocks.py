"""Raw bytes cut into descriptors, as long as each says it is (USB 2.0, 9.5).

Every descriptor begins with bLength (itself included) and bDescriptorType. Numbers are
little-endian. A bLength below 2 leads nowhere, so cutting ends there; one that points beyond the
end gives what there is.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

from device.usb.descriptors.names import type_name
from device.usb.descriptors.problems import Findings

LENGTH_MIN = 2


@dataclass(frozen=True, slots=True)
class Descriptor:
    """Any descriptor: where it stood and its bytes, extra ones included.

    offset: bytes from the first that were given; raw: all its bytes.
    """

    offset: int
    raw: bytes

    kind: ClassVar[str] = "descriptor"

    def __init_subclass__(cls) -> None:
        """Call the kind as the class, an `InputTerminal` "input terminal", unless it says more."""
        if "kind" not in vars(cls):
            cls.kind = re.sub("(?<=.)([A-Z])", r" \1", cls.__name__).lower()

    @property
    def title(self) -> str:
        """What a person calls it."""
        return self.kind


@dataclass(frozen=True, slots=True)
class OtherDescriptor(Descriptor):
    """A descriptor that is named and kept, but not understood. name: as far as it is known."""

    name: str

    kind: ClassVar[str] = "descriptor"

    @property
    def title(self) -> str:
        """What a person calls it."""
        return self.name


class Block:
    """The bytes of one descriptor while it is read; `name` is its name in problems."""

    __slots__ = ("findings", "name", "offset", "raw")

    def __init__(self, offset: int, raw: bytes, name: str, findings: Findings) -> None:
        self.offset = offset
        self.raw = raw
        self.name = name
        self.findings = findings

    @property
    def type(self) -> int:
        """The bDescriptorType."""
        return self.raw[1]

    @property
    def subtype(self) -> int:
        """The bDescriptorSubtype of a class-specific descriptor, 0 (undefined) if missing."""
        return self.raw[2] if len(self.raw) > 2 else 0

    def u16(self, at: int) -> int:
        """The 2 bytes at a place that `holds` has vouched for, as a number."""
        return self.raw[at] | self.raw[at + 1] << 8

    def u24(self, at: int) -> int:
        """The 3 bytes there."""
        return self.raw[at] | self.raw[at + 1] << 8 | self.raw[at + 2] << 16

    def u32(self, at: int) -> int:
        """The 4 bytes there."""
        return int.from_bytes(self.raw[at : at + 4], "little")

    def note(self, found: str, allowed: str) -> None:
        """Take a problem of this descriptor; raises in strict mode."""
        self.findings.note(self.offset, self.name, found, allowed)

    def holds(self, length: int) -> bool:
        """Whether the block has at least this many bytes; if not, a problem is noted."""
        if len(self.raw) >= length:
            return True
        self.note(f"it is {len(self.raw)} bytes long", f"{length} or more")
        return False

    def other(self) -> OtherDescriptor:
        """The descriptor, named and kept."""
        return OtherDescriptor(self.offset, self.raw, self.name)


Reader = Callable[[Block], Descriptor | None]
"""Makes a descriptor from a block; notes a problem and returns None if bytes are missing."""


def blocks(raw: bytes, at: int, findings: Findings) -> Iterator[Block]:
    """Every descriptor from a place on, of at least 2 bytes; ends before bytes that can be none."""
    end = len(raw)
    while at < end:
        length, left = raw[at], end - at
        if length < LENGTH_MIN:
            findings.note(at, "descriptor", f"bLength is {length}", f"{LENGTH_MIN} to {left}")
            return
        if left < LENGTH_MIN:
            findings.note(at, "descriptor", "1 byte is left", "whole descriptors")
            return
        name = type_name(raw[at + 1])
        if length > left:
            findings.note(
                at, name, f"bLength is {length}", f"{LENGTH_MIN} to {left}, up to the end"
            )
        yield Block(at, raw[at : at + length], name, findings)
        at += length
