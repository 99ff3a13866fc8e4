"""Terminals, units and clocks of audio functions, of USB Audio 1.0 (4.3.2) and 2.0 (4.7.2).

Sound flows from an entity to those that name it in `source_ids`; clocks flow the same way between
clock entities. An id is unique within one audio function.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from device.usb.descriptors.blocks import Block
from device.values import counted

USB_STREAMING = 0x0101
"""The terminal type of streams from or to the host."""

VOLUME_UNITS_PER_DB = 256
"""Volume controls count in 1/256 dB, signed 16 bit; -32768 is silence (1.0: 5.2.2.4.3.2)."""

INPUT, OUTPUT, FEATURE = "input terminal", "output terminal", "feature unit"
CLOCK_SOURCE = "clock source"
CLOCKS = (CLOCK_SOURCE, "clock selector", "clock multiplier")


class FeatureControl(IntEnum):
    """A control of a feature unit; its place in the bit maps (1.0: 4.3.2.5; 2.0: 4.7.2.8)."""

    MUTE = 0
    VOLUME = 1


@dataclass(frozen=True, slots=True)
class Entity:
    """A terminal, unit or clock."""

    offset: int  # bytes from the first of the configuration
    uac: int  # version of USB Audio, 1 or 2
    kind: str  # "input terminal", "feature unit" and so on
    id: int  # 1 to 255
    source_ids: tuple[int, ...]  # entities that it takes its input from
    clock_ids: tuple[int, ...]  # of a terminal or converter of 2.0
    terminal_type: int  # wTerminalType, 0 for others
    channels: int  # of an input terminal, 0 for others
    channel_config: int  # one bit a loudspeaker position
    controls: tuple[int, ...]  # bit maps of a feature unit by channel; 0 is the master

    def settable(self, control: FeatureControl) -> tuple[int, ...]:
        """Return the channels whose control the host may set; 0 is the master."""
        # 1.0 has one bit a control, 2.0 has two: readable and writable.
        bits = 1 << control if self.uac == 1 else 3 << 2 * control
        return tuple(c for c, bit_map in enumerate(self.controls) if bit_map & bits == bits)


class _Layout(NamedTuple):
    """Where a descriptor has its fields, in bytes from its beginning; 0 if it has none."""

    kind: str
    least: int  # its bytes without ids of sources
    source: int = 0
    sources: int = 0  # bNrInPins, with the ids behind it
    clocks: tuple[int, ...] = ()
    terminal_type: int = 0
    channels: int = 0  # wChannelConfig (1.0) or bmChannelConfig (2.0) follows them


_LAYOUTS: dict[int, dict[int, _Layout]] = {
    1: {
        0x02: _Layout(INPUT, 12, terminal_type=4, channels=7),
        0x03: _Layout(OUTPUT, 9, terminal_type=4, source=7),
        0x04: _Layout("mixer unit", 10, sources=4),
        0x05: _Layout("selector unit", 6, sources=4),
        0x06: _Layout(FEATURE, 7, source=4),
        0x07: _Layout("processing unit", 13, sources=6),
        0x08: _Layout("extension unit", 13, sources=6),
    },
    2: {
        0x02: _Layout(INPUT, 17, terminal_type=4, clocks=(7,), channels=8),
        0x03: _Layout(OUTPUT, 12, terminal_type=4, source=7, clocks=(8,)),
        0x04: _Layout("mixer unit", 13, sources=4),
        0x05: _Layout("selector unit", 7, sources=4),
        0x06: _Layout(FEATURE, 6, source=4),
        0x07: _Layout("effect unit", 16, source=6),
        0x08: _Layout("processing unit", 16, sources=6),
        0x09: _Layout("extension unit", 15, sources=6),
        0x0A: _Layout(CLOCK_SOURCE, 8),
        0x0B: _Layout("clock selector", 7, sources=4),
        0x0C: _Layout("clock multiplier", 7, source=4),
        0x0D: _Layout("sample rate converter", 8, source=4, clocks=(5, 6)),
    },
}
"""By version and bDescriptorSubtype (1.0: table A-5; 2.0: table A-9)."""


def read_entity(block: Block, uac: int) -> Entity | None:
    """Return the entity; None if the block is another descriptor, or damaged."""
    layout = _LAYOUTS.get(uac, {}).get(block.subtype)
    if layout is None:
        return None
    block.name = layout.kind
    if not block.holds(layout.least):
        return None
    raw = block.raw
    source_ids: tuple[int, ...] = (raw[layout.source],) if layout.source else ()
    if layout.sources:
        count, room = raw[layout.sources], len(raw) - layout.least
        if count > room:
            block.note(f"bNrInPins is {count}, but its length has room for {room}; it is ignored")
            return None
        source_ids = tuple(raw[layout.sources + 1 : layout.sources + 1 + count])
    at = layout.channels
    return Entity(
        offset=block.offset,
        uac=uac,
        kind=layout.kind,
        id=raw[3],
        source_ids=source_ids,
        clock_ids=tuple(raw[place] for place in layout.clocks),
        terminal_type=block.number(layout.terminal_type, 2) if layout.terminal_type else 0,
        channels=raw[at] if at else 0,
        channel_config=block.number(at + 1, 2 * uac) if at else 0,
        controls=_bit_maps(block, uac) if layout.kind == FEATURE else (),
    )


def _bit_maps(block: Block, uac: int) -> tuple[int, ...]:
    """Return the bit maps of a feature unit, which end before its last byte."""
    at, size = (6, block.raw[5]) if uac == 1 else (5, 4)
    if not size:
        block.note("bControlSize is 0; its volume and mute are unknown")
        return ()
    left = len(block.raw) - at - 1
    if left % size:
        block.note(f"its bit maps of {counted(size, 'bytes')} have {counted(left, 'bytes')} in all")
        # Some devices leave out the string index; the last byte then belongs to a bit map.
        left += (left + 1) % size == 0
    return tuple(block.number(here, size) for here in range(at, at + left // size * size, size))


def read_header(block: Block, uac: int) -> tuple[int, ...]:
    """Return the streaming interfaces that the header of a function of 1.0 lists."""
    block.name = "audio control header"
    if uac != 1 or not block.holds(8):
        return ()
    count, room = block.raw[7], len(block.raw) - 8
    if count > room:
        block.note(f"bInCollection is {count}, but its length has room for {room}")
    return tuple(block.raw[8 : 8 + count])
