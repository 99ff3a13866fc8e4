"""Audio control descriptors of USB Audio 1.0 (4.3.2) and 2.0 (4.7.2), each read from its block.

Most are read by a table: the fields from byte 3 on, each with its number of bytes. A reader returns
None where too little is there to be understood, after a problem was noted.
"""

from __future__ import annotations

from typing import Any

from device.usb.descriptors.blocks import Block, Reader
from device.usb.descriptors.entities import (
    ClockKind,
    ClockMultiplier,
    ClockSelector,
    ClockSource,
    ControlHeader,
    EffectUnit,
    Entity,
    ExtensionUnit,
    FeatureUnit,
    InputTerminal,
    MixerUnit,
    OutputTerminal,
    ProcessingUnit,
    SampleRateConverter,
    SelectorUnit,
)

_MAP_BYTES_2 = 4

_SOURCES = "bNrInPins"
_COUNTED = "bControlSize"
_REST = "the rest"
_SKIPPED = "skipped"


def _room(block: Block, field: str, at: int, behind: int) -> tuple[int, bool]:
    """Return a count at a place, and whether that many bytes fit before those that must follow."""
    count, room = block.raw[at], len(block.raw) - at - 1 - behind
    if count > room:
        block.note(f"{field} is {count}", f"0 to {max(room, 0)}, which its length leaves room for")
    return min(count, max(room, 0)), count <= room


def _table(
    entity: type[Entity], layout: list[tuple[str, int]], **constants: Any
) -> tuple[str, Reader]:
    """Return the name and the reader of an entity.

    layout: fields with their bytes. `_SOURCES` counts the source ids behind it, `_COUNTED` the
    bytes of `controls`; `_REST` is all that the fields behind it leave, and becomes `controls`.
    """
    layout = [("id", 1), *layout]
    least = 3 + sum(size for _, size in layout)

    def read(block: Block) -> Entity | None:
        if not block.holds(least):
            return None
        values: dict[str, Any] = {"source_ids": (), **constants}
        at, behind = 3, least - 3
        for name, size in layout:
            behind -= size
            if name == _SOURCES:
                count, fits = _room(block, name, at, behind)
                if not fits:
                    return None
                values["source_ids"] = tuple(block.raw[at + 1 : at + 1 + count])
                at += count
            elif name == _COUNTED:
                count, _ = _room(block, name, at, behind)
                values["controls"] = block.raw[at + 1 : at + 1 + count]
                at += count
            elif name == _REST:
                values["controls"] = block.raw[at : len(block.raw) - behind]
                at = len(block.raw) - behind
            elif name == "source_ids":
                values[name] = (block.raw[at],)
            elif name != _SKIPPED:
                values[name] = int.from_bytes(block.raw[at : at + size], "little")
            at += size
        if issubclass(entity, ProcessingUnit) and isinstance(values["controls"], int):
            values["controls"] = values["controls"].to_bytes(dict(layout)["controls"], "little")
        return entity(block.offset, block.raw, **values)

    return entity.kind, read


def _header_1(block: Block) -> ControlHeader | None:
    if not block.holds(8):
        return None
    count, _ = _room(block, "bInCollection", 7, 0)
    return ControlHeader(
        block.offset,
        block.raw,
        release=block.u16(3),
        total_bytes=block.u16(5),
        interfaces=tuple(block.raw[8 : 8 + count]),
        category=None,
    )


def _header_2(block: Block) -> ControlHeader | None:
    if not block.holds(9):
        return None
    return ControlHeader(
        block.offset,
        block.raw,
        release=block.u16(3),
        total_bytes=block.u16(6),
        interfaces=(),
        category=block.raw[5],
    )


def _maps(block: Block, at: int, size: int, found: str = "") -> tuple[tuple[int, ...], int]:
    """Return the bit maps from a place on, and the string index behind them."""
    left, string_index = len(block.raw) - at - 1, block.raw[-1]
    if left % size:
        block.note(f"{found}{left} bytes are left for bit maps", f"a multiple of {size} bytes")
        if (left + 1) % size == 0:
            # Devices exist that leave out the string index; the last byte belongs to a bit map.
            left, string_index = left + 1, 0
    starts = range(at, at + left // size * size, size)
    maps = tuple(int.from_bytes(block.raw[here : here + size], "little") for here in starts)
    return maps, string_index


def _feature_1(block: Block) -> FeatureUnit | None:
    if not block.holds(7):
        return None
    size = block.raw[5]
    if size:
        controls, string_index = _maps(block, 6, size, f"bControlSize is {size}, and ")
    else:
        block.note("bControlSize is 0", "1 or more")
        controls, string_index = (), block.raw[-1]
    source_ids = (block.raw[4],)
    return FeatureUnit(block.offset, block.raw, block.raw[3], source_ids, 1, controls, string_index)


def _feature_2(block: Block) -> FeatureUnit | None:
    if not block.holds(6):
        return None
    controls, string_index = _maps(block, 5, _MAP_BYTES_2)
    for channel, bits in enumerate(controls):
        # Two bits a control: 10 would be a control that can be written but not read.
        if bits >> 1 & ~bits & 0x5555_5555:
            block.note(f"bmaControls({channel}) is 0x{bits:08x}", "no two bits that are 10")
    source_ids = (block.raw[4],)
    return FeatureUnit(block.offset, block.raw, block.raw[3], source_ids, 2, controls, string_index)


def _effect(block: Block) -> EffectUnit | None:
    if not block.holds(16):
        return None
    controls, string_index = _maps(block, 7, _MAP_BYTES_2)
    source_ids, effect_type = (block.raw[6],), block.u16(4)
    return EffectUnit(
        block.offset, block.raw, block.raw[3], source_ids, effect_type, controls, string_index
    )


def _clock_source(block: Block) -> ClockSource | None:
    if not block.holds(8):
        return None
    return ClockSource(
        block.offset,
        block.raw,
        id=block.raw[3],
        source_ids=(),
        controls=block.raw[5],
        string_index=block.raw[7],
        clock_kind=ClockKind(block.raw[4] & 3),
        follows_usb_frames=bool(block.raw[4] & 4),
        terminal_id=block.raw[6],
    )


_TYPE = [("terminal_type", 2), ("associated", 1)]
_STRING = [("string_index", 1)]
_CONTROLS = [("controls", 1), *_STRING]
_PROCESS = [("process_type", 2), (_SOURCES, 1)]


def _cluster(config_bytes: int) -> list[tuple[str, int]]:
    return [("channels", 1), ("channel_config", config_bytes), ("channel_names_string", 1)]


_PROCESSING_1 = [*_PROCESS, *_cluster(2), (_COUNTED, 1), *_STRING]
_SELECTOR_2 = [(_SOURCES, 1), *_CONTROLS]

_V1 = {"clock_id": None, "controls": 0}

CONTROL_READERS: dict[int, dict[int, tuple[str, Reader]]] = {
    1: {
        1: (ControlHeader.kind, _header_1),
        2: _table(InputTerminal, [*_TYPE, *_cluster(2), *_STRING], **_V1),
        3: _table(OutputTerminal, [*_TYPE, ("source_ids", 1), *_STRING], **_V1),
        4: _table(MixerUnit, [(_SOURCES, 1), *_cluster(2), (_REST, 0), *_STRING]),
        5: _table(SelectorUnit, [(_SOURCES, 1), *_STRING], controls=0),
        6: (FeatureUnit.kind, _feature_1),
        7: _table(ProcessingUnit, _PROCESSING_1),
        8: _table(ExtensionUnit, _PROCESSING_1),
    },
    2: {
        0x01: (ControlHeader.kind, _header_2),
        0x02: _table(
            InputTerminal,
            [*_TYPE, ("clock_id", 1), *_cluster(4), ("controls", 2), *_STRING],
        ),
        0x03: _table(
            OutputTerminal,
            [*_TYPE, ("source_ids", 1), ("clock_id", 1), ("controls", 2), *_STRING],
        ),
        0x04: _table(MixerUnit, [(_SOURCES, 1), *_cluster(4), (_REST, 0), (_SKIPPED, 1), *_STRING]),
        0x05: _table(SelectorUnit, _SELECTOR_2),
        0x06: (FeatureUnit.kind, _feature_2),
        0x07: (EffectUnit.kind, _effect),
        0x08: _table(ProcessingUnit, [*_PROCESS, *_cluster(4), ("controls", 2), *_STRING]),
        0x09: _table(ExtensionUnit, [*_PROCESS, *_cluster(4), *_CONTROLS]),
        0x0A: (ClockSource.kind, _clock_source),
        0x0B: _table(ClockSelector, _SELECTOR_2),
        0x0C: _table(ClockMultiplier, [("source_ids", 1), *_CONTROLS]),
        0x0D: _table(
            SampleRateConverter,
            [("source_ids", 1), ("clock_in_id", 1), ("clock_out_id", 1), *_STRING],
        ),
    },
}
"""By version and bDescriptorSubtype: the name and the reader (1.0: table A-5; 2.0: table A-9)."""
