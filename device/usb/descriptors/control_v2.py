"""Audio control descriptors of USB Audio 2.0 (4.7.2), each read from its block.

A reader returns None where too little is there to be understood, after a problem was noted.
"""

from __future__ import annotations

from device.usb.descriptors.blocks import Block, Reader
from device.usb.descriptors.control_v1 import read_pins
from device.usb.descriptors.entities import (
    ClockKind,
    ClockMultiplier,
    ClockSelector,
    ClockSource,
    ControlHeader,
    EffectUnit,
    ExtensionUnit,
    FeatureUnit,
    InputTerminal,
    MixerUnit,
    OutputTerminal,
    ProcessingUnit,
    SampleRateConverter,
    SelectorUnit,
)

_EXTENSION_UNIT = 9
_MAP_BYTES = 4


def _header(block: Block) -> ControlHeader | None:
    if not block.holds(9):
        return None
    return ControlHeader(
        offset=block.offset,
        raw=block.raw,
        release=block.u16(3),
        total_bytes=block.u16(6),
        interfaces=(),
        category=block.raw[5],
    )


def _input_terminal(block: Block) -> InputTerminal | None:
    if not block.holds(17):
        return None
    return InputTerminal(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=(),
        terminal_type=block.u16(4),
        associated=block.raw[6],
        clock_id=block.raw[7],
        channels=block.raw[8],
        channel_config=block.u32(9),
        channel_names_string=block.raw[13],
        controls=block.u16(14),
        string_index=block.raw[16],
    )


def _output_terminal(block: Block) -> OutputTerminal | None:
    if not block.holds(12):
        return None
    return OutputTerminal(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=(block.raw[7],),
        terminal_type=block.u16(4),
        associated=block.raw[6],
        clock_id=block.raw[8],
        controls=block.u16(9),
        string_index=block.raw[11],
    )


def _mixer_unit(block: Block) -> MixerUnit | None:
    if not block.holds(13):
        return None
    sources = read_pins(block, 4, behind=8)
    if sources is None:
        return None
    at = 5 + len(sources)
    return MixerUnit(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=sources,
        channels=block.raw[at],
        channel_config=block.u32(at + 1),
        channel_names_string=block.raw[at + 5],
        controls=block.raw[at + 6 : -2],
        string_index=block.raw[-1],
    )


def _selector_unit(block: Block) -> SelectorUnit | ClockSelector | None:
    if not block.holds(7):
        return None
    sources = read_pins(block, 4, behind=2)
    if sources is None:
        return None
    at = 5 + len(sources)
    unit = ClockSelector if block.name == ClockSelector.kind else SelectorUnit
    return unit(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=sources,
        controls=block.raw[at],
        string_index=block.raw[at + 1],
    )


def _feature_unit(block: Block) -> FeatureUnit | None:
    if not block.holds(6):
        return None
    controls, string_index = _maps(block, 5)
    unit = FeatureUnit(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=(block.raw[4],),
        uac=2,
        controls=controls,
        string_index=string_index,
    )
    for channel, bits in enumerate(controls):
        # Two bits a control: 10 would be a control that can be written but not read.
        if bits >> 1 & ~bits & 0x5555_5555:
            block.note(f"bmaControls({channel}) is 0x{bits:08x}", "no two bits that are 10")
    return unit


def _maps(block: Block, at: int) -> tuple[tuple[int, ...], int]:
    """The bit maps from a place on, and the string index behind them."""
    room = len(block.raw) - at - 1
    string_index = block.raw[-1]
    if room % _MAP_BYTES:
        block.note(f"{room} bytes are left for bit maps", f"a multiple of {_MAP_BYTES} bytes")
        if (room + 1) % _MAP_BYTES == 0:
            # Without the string index at the end the last byte belongs to a bit map.
            room, string_index = room + 1, 0
    ends = range(at, at + room // _MAP_BYTES * _MAP_BYTES, _MAP_BYTES)
    return tuple(block.u32(start) for start in ends), string_index


def _effect_unit(block: Block) -> EffectUnit | None:
    if not block.holds(16):
        return None
    controls, string_index = _maps(block, 7)
    return EffectUnit(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=(block.raw[6],),
        effect_type=block.u16(4),
        controls=controls,
        string_index=string_index,
    )


def _processing_unit(block: Block) -> ProcessingUnit | None:
    extension = block.subtype == _EXTENSION_UNIT
    control_bytes = 1 if extension else 2
    if not block.holds(14 + control_bytes):
        return None
    sources = read_pins(block, 6, behind=7 + control_bytes)
    if sources is None:
        return None
    at = 7 + len(sources)
    unit = ExtensionUnit if extension else ProcessingUnit
    return unit(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=sources,
        process_type=block.u16(4),
        channels=block.raw[at],
        channel_config=block.u32(at + 1),
        channel_names_string=block.raw[at + 5],
        controls=block.raw[at + 6 : at + 6 + control_bytes],
        string_index=block.raw[at + 6 + control_bytes],
    )


def _clock_source(block: Block) -> ClockSource | None:
    if not block.holds(8):
        return None
    return ClockSource(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=(),
        controls=block.raw[5],
        string_index=block.raw[7],
        clock_kind=ClockKind(block.raw[4] & 3),
        follows_usb_frames=bool(block.raw[4] & 4),
        terminal_id=block.raw[6],
    )


def _clock_multiplier(block: Block) -> ClockMultiplier | None:
    if not block.holds(7):
        return None
    return ClockMultiplier(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=(block.raw[4],),
        controls=block.raw[5],
        string_index=block.raw[6],
    )


def _sample_rate_converter(block: Block) -> SampleRateConverter | None:
    if not block.holds(8):
        return None
    return SampleRateConverter(
        offset=block.offset,
        raw=block.raw,
        id=block.raw[3],
        source_ids=(block.raw[4],),
        clock_in_id=block.raw[5],
        clock_out_id=block.raw[6],
        string_index=block.raw[7],
    )


CONTROL_READERS: dict[int, tuple[str, Reader]] = {
    0x01: (ControlHeader.kind, _header),
    0x02: (InputTerminal.kind, _input_terminal),
    0x03: (OutputTerminal.kind, _output_terminal),
    0x04: (MixerUnit.kind, _mixer_unit),
    0x05: (SelectorUnit.kind, _selector_unit),
    0x06: (FeatureUnit.kind, _feature_unit),
    0x07: (EffectUnit.kind, _effect_unit),
    0x08: (ProcessingUnit.kind, _processing_unit),
    _EXTENSION_UNIT: (ExtensionUnit.kind, _processing_unit),
    0x0A: (ClockSource.kind, _clock_source),
    0x0B: (ClockSelector.kind, _selector_unit),
    0x0C: (ClockMultiplier.kind, _clock_multiplier),
    0x0D: (SampleRateConverter.kind, _sample_rate_converter),
}
"""By bDescriptorSubtype: the name and the reader (2.0: table A-9)."""
