"""Class-specific descriptors: terminals, units and clocks, and the formats of streams.

An entity is a terminal, a unit or a clock. Its `source_ids` are the ids of the entities that supply
its sound or clock. An id is unique within one audio function. In 2.0 and 3.0, samplerates belong to
a clock; no descriptor contains them.

Sources: USB Audio 1.0, 4.3.2, 4.5.2 and Data Formats 1.0, 2.2.5; 2.0, 4.7.2, 4.9.2 and Data Formats
2.0, 2.3; 3.0, 4.7.2.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from device.usb.descriptors.blocks import Block
from device.values import counted

USB_STREAMING = 0x0101  # terminal type of streams from or to the host
VOLUME_UNITS_PER_DB = 256  # signed 16-bit volume; -32768 is silence (1.0: 5.2.2.4.3.2)

INPUT, OUTPUT, FEATURE = "input terminal", "output terminal", "feature unit"
CLOCK_SOURCE = "clock source"
CLOCKS = (CLOCK_SOURCE, "clock selector", "clock multiplier")

_TYPE_I, _EXTENDED_TYPE_I = 0x01, 0x81

_ENCODINGS = ("PCM", "PCM8", "IEEE float", "A-law", "mu-law")
# names by number in 1.0, by bit in 2.0 and 3.0
_ENCODINGS_1 = dict(enumerate(("undefined", *_ENCODINGS))) | {0x1001: "MPEG", 0x1002: "AC-3"}
_ENCODINGS_2 = dict(enumerate(_ENCODINGS)) | {31: "raw data"}
_ENCODINGS_3 = dict(enumerate((*_ENCODINGS, "DSD", "raw data")))


# controls of a feature unit; value: place in bit maps (1.0: 4.3.2.5; 2.0: 4.7.2.8)
FeatureControl = IntEnum("FeatureControl", "MUTE VOLUME", start=0)


@dataclass(frozen=True, slots=True)
class Entity:
    """A terminal, unit or clock."""

    offset: int  # bytes from the start of the configuration
    uac: int  # version of USB Audio, 1 or 2
    kind: str  # "input terminal", "feature unit" and so on
    id: int  # 1 to 255
    source_ids: tuple[int, ...]  # entities from which it receives sound or a clock
    clock_ids: tuple[int, ...]  # of a terminal or converter of 2.0
    terminal_type: int  # wTerminalType, 0 for other entities
    channels: int  # of an input terminal, 0 for other entities
    channel_config: int  # one bit for each loudspeaker position
    controls: tuple[int, ...]  # bit maps of a feature unit by channel; 0 is the master

    def settable(self, control: FeatureControl) -> tuple[int, ...]:
        """Return the channels on which the host may set a control; channel 0 is the master."""
        # 1.0 has one bit for each control, 2.0 has two bits: readable and writable
        bits = 1 << control if self.uac == 1 else 3 << 2 * control
        return tuple(c for c, bit_map in enumerate(self.controls) if bit_map & bits == bits)


class _Layout(NamedTuple):
    """Positions of a descriptor's fields, in bytes from its start; 0 for a missing field."""

    kind: str
    least: int  # length without the ids of sources
    source: int = 0
    sources: int = 0  # bNrInPins, followed by the ids
    clocks: tuple[int, ...] = ()
    terminal_type: int = 0
    channels: int = 0  # followed by wChannelConfig (1.0) or bmChannelConfig (2.0)


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
"""Layouts by version of USB Audio, then by bDescriptorSubtype (1.0: table A-5; 2.0: table A-9)."""


def read_entity(block: Block, uac: int) -> Entity | None:
    """Return the entity that a descriptor describes; None if it describes none or is invalid."""
    if (layout := _LAYOUTS.get(uac, {}).get(block.subtype)) is None:
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
    """Return each channel's bit map of controls; the descriptor's last byte is in no map."""
    at, size = (6, block.raw[5]) if uac == 1 else (5, 4)
    if not size:
        block.note("bControlSize is 0; its volume and mute are unknown")
        return ()
    left = len(block.raw) - at - 1
    if left % size:
        block.note(f"its bit maps of {counted(size, 'bytes')} have {counted(left, 'bytes')} in all")
        # Some devices omit the string index; the last byte then belongs to a bit map.
        left += (left + 1) % size == 0
    return tuple(block.number(here, size) for here in range(at, at + left // size * size, size))


def read_header(block: Block, uac: int) -> tuple[int, ...]:
    """Return the interface numbers that a header of USB Audio 1.0 lists; else ()."""
    block.name = "audio control header"
    if uac != 1 or not block.holds(8):
        return ()
    count, room = block.raw[7], len(block.raw) - 8
    if count > room:
        block.note(f"bInCollection is {count}, but its length has room for {room}")
    return tuple(block.raw[8 : 8 + count])


@dataclass(frozen=True, slots=True)
class RateRange:
    """All samplerates from lowest to highest, in Hz. lowest, highest: the limits."""

    lowest: int
    highest: int


@dataclass(frozen=True, slots=True)
class StreamGeneral:
    """The sample encoding and channels of an alternate setting."""

    offset: int  # bytes from the start of the configuration
    terminal_link: int  # id of its terminal
    encodings: tuple[str, ...]  # "PCM", "IEEE float" and so on
    channels: int | None = None  # 2.0 only
    channel_config: int | None = None  # one bit for each loudspeaker position; 2.0 only
    subslot_bytes: int = 0  # as in `StreamFormat`; 3.0 only
    bits: int = 0


@dataclass(frozen=True, slots=True)
class StreamFormat:
    """The sample format of a stream of type I. For other types, subslot_bytes and bits are 0."""

    subslot_bytes: int  # bytes of a sample (bSubframeSize in 1.0)
    bits: int  # number of significant upper bits of a sample
    channels: int | None = None  # 1.0 only
    samplerates: tuple[int, ...] | RateRange | None = None  # Hz; 1.0 only


def read_general(block: Block, uac: int) -> StreamGeneral | None:
    """Decode a stream's general descriptor; return None if it is too short."""
    block.name = "streaming general"
    if not block.holds({1: 7, 2: 16, 3: 23}[uac]):
        return None
    at, raw, link = block.offset, block.raw, block.raw[3]
    if uac == 1:
        tag = block.number(5, 2)
        return StreamGeneral(at, link, (_ENCODINGS_1.get(tag) or f"format 0x{tag:04x}",))
    if uac == 2:
        encodings = _named_bits(block.number(6, 4), _ENCODINGS_2)
        if not raw[10]:
            block.note("it has 0 channels")
        return StreamGeneral(at, link, encodings, raw[10], block.number(11, 4))
    encodings = _named_bits(block.number(10, 8), _ENCODINGS_3)
    return StreamGeneral(at, link, encodings, subslot_bytes=raw[18], bits=raw[19])


def _named_bits(bits: int, names: Mapping[int, str]) -> tuple[str, ...]:
    found = (bit for bit in range(bits.bit_length()) if bits >> bit & 1)
    return tuple(names.get(bit) or f"format bit {bit}" for bit in found)


def read_format(block: Block, uac: int) -> StreamFormat | None:
    """Decode a format descriptor of 1.0 or 2.0; return None if it is too short."""
    block.name = "format type"
    if not block.holds(4):
        return None
    if block.raw[3] != _TYPE_I and (uac == 1 or block.raw[3] != _EXTENDED_TYPE_I):
        return StreamFormat(0, 0)
    if not block.holds(8 if uac == 1 else 6):
        return None
    if uac == 2:
        found = StreamFormat(*block.raw[4:6])
    else:
        channels, subslot_bytes, bits = block.raw[4:7]
        found = StreamFormat(subslot_bytes, bits, channels, _samplerates(block))
        if not channels:
            block.note("it has 0 channels")
    if not 1 <= found.subslot_bytes <= 4 or not 1 <= found.bits <= 8 * found.subslot_bytes:
        block.note(f"{found.bits} bits a sample in {found.subslot_bytes} bytes are impossible")
    return found


def _samplerates(block: Block) -> tuple[int, ...] | RateRange:
    """Return the valid samplerates in a format descriptor of 1.0, in Hz."""
    count, room = block.raw[7], (len(block.raw) - 8) // 3
    rates = tuple(block.number(8 + 3 * place, 3) for place in range(min(count or 2, room)))
    if not count and room >= 2:
        lowest, highest = sorted(rates)
        if not 0 < rates[0] <= rates[1]:
            block.note(f"samplerates from {rates[0]} to {rates[1]} Hz are impossible")
        return RateRange(max(lowest, 1), highest) if highest else ()
    if not count:
        block.note("bSamFreqType is 0 (a range), but its length has no room for two samplerates")
        return ()
    if count > room:
        block.note(f"bSamFreqType is {count}, but its length has room for {room}")
    if 0 in rates:
        block.note("a samplerate is 0 Hz")
    return tuple(rate for rate in rates if rate)
