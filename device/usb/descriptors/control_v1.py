"""Audio control descriptors of USB Audio 1.0 (4.3.2), each read from its block.

A reader returns None where too little is there to be understood, after a problem was noted.
"""

from __future__ import annotations

from device.usb.descriptors.blocks import Block, Reader
from device.usb.descriptors.entities import (
    ControlHeader,
    ExtensionUnit,
    FeatureUnit,
    InputTerminal,
    MixerUnit,
    OutputTerminal,
    ProcessingUnit,
    SelectorUnit,
)

_EXTENSION_UNIT = 8


def read_pins(block: Block, at: int, behind: int) -> tuple[int, ...] | None:
    """The source ids behind a bNrInPins; None where they or the bytes after them do not fit.

    at: where the count stands; behind: how many bytes have to follow the ids.
    """
    count, room = block.raw[at], len(block.raw) - at - 1 - behind
    if count > room:
        block.note(
            f"bNrInPins is {count}", f"0 to {max(room, 0)}, which its length leaves room for"
        )
        return None
    return tuple(block.raw[at + 1 : at + 1 + count])


def _header(block: Block) -> ControlHeader | None:
    if not block.holds(8):
        return None
    count, room = block.raw[7], len(block.raw) - 8
    if count > room:
        block.note(f"bInCollection is {count}", f"0 to {room}, which its length leaves room for")
    return ControlHeader(
        offset=block.offset,
        raw=block.raw,
        release=block.u16(3),
        total_bytes=block.u16(5),
        interfaces=tuple(block.raw[8 : 8 + count]),
        category=None,
    )


def _input_terminal(block: Block) -> InputTerminal | None:
    if not block.holds(12):
        return None
    return InputTerminal(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=(),
        terminal_type=block.u16(4),
        associated=block.raw[6],
        clock_id=None,
        channels=block.raw[7],
        channel_config=block.u16(8),
        channel_names_string=block.raw[10],
        controls=0,
        string_index=block.raw[11],
    )


def _output_terminal(block: Block) -> OutputTerminal | None:
    if not block.holds(9):
        return None
    return OutputTerminal(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=(block.raw[7],),
        terminal_type=block.u16(4),
        associated=block.raw[6],
        clock_id=None,
        controls=0,
        string_index=block.raw[8],
    )


def _mixer_unit(block: Block) -> MixerUnit | None:
    if not block.holds(10):
        return None
    sources = read_pins(block, 4, behind=5)
    if sources is None:
        return None
    at = 5 + len(sources)
    return MixerUnit(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=sources,
        channels=block.raw[at],
        channel_config=block.u16(at + 1),
        channel_names_string=block.raw[at + 3],
        controls=block.raw[at + 4 : -1],
        string_index=block.raw[-1],
    )


def _selector_unit(block: Block) -> SelectorUnit | None:
    if not block.holds(6):
        return None
    sources = read_pins(block, 4, behind=1)
    if sources is None:
        return None
    return SelectorUnit(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=sources,
        controls=0,
        string_index=block.raw[5 + len(sources)],
    )


def _feature_unit(block: Block) -> FeatureUnit | None:
    if not block.holds(7):
        return None
    size = block.raw[5]
    maps = block.raw[6:-1]
    string_index = block.raw[-1]
    if not size:
        block.note("bControlSize is 0", "1 or more")
        maps = b""
    elif len(maps) % size:
        block.note(
            f"bControlSize is {size}, and {len(maps)} bytes are left for bit maps",
            f"a multiple of {size} bytes",
        )
        if (len(maps) + 1) % size == 0:
            # Devices exist that leave out iFeature; the last byte then belongs to a bit map.
            maps, string_index = block.raw[6:], 0
        maps = maps[: len(maps) // size * size]
    return FeatureUnit(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=(block.raw[4],),
        uac=1,
        controls=tuple(
            int.from_bytes(maps[at : at + size], "little") for at in range(0, len(maps), size or 1)
        ),
        string_index=string_index,
    )


def _processing_unit(block: Block) -> ProcessingUnit | None:
    if not block.holds(13):
        return None
    sources = read_pins(block, 6, behind=6)
    if sources is None:
        return None
    at = 7 + len(sources)
    size, room = block.raw[at + 4], len(block.raw) - at - 6
    if size > room:
        block.note(f"bControlSize is {size}", f"0 to {room}, which its length leaves room for")
        size = room
    unit = ExtensionUnit if block.subtype == _EXTENSION_UNIT else ProcessingUnit
    return unit(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=sources,
        process_type=block.u16(4),
        channels=block.raw[at],
        channel_config=block.u16(at + 1),
        channel_names_string=block.raw[at + 3],
        controls=block.raw[at + 5 : at + 5 + size],
        string_index=block.raw[at + 5 + size],
    )


CONTROL_READERS: dict[int, tuple[str, Reader]] = {
    1: (ControlHeader.kind, _header),
    2: (InputTerminal.kind, _input_terminal),
    3: (OutputTerminal.kind, _output_terminal),
    4: (MixerUnit.kind, _mixer_unit),
    5: (SelectorUnit.kind, _selector_unit),
    6: (FeatureUnit.kind, _feature_unit),
    7: (ProcessingUnit.kind, _processing_unit),
    _EXTENSION_UNIT: (ExtensionUnit.kind, _processing_unit),
}
"""By bDescriptorSubtype: the name and the reader (1.0: table A-5)."""
