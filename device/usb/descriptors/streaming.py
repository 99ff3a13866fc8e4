"""Audio streaming descriptors of USB Audio 1.0 to 3.0: general, format type, endpoint.

Source: 1.0: 4.5.2, 4.6.1.2 and Data Formats 1.0, 2.2.5; 2.0: 4.9.2, 4.10.1.2 and Data Formats
2.0, 2.3; 3.0: 4.7.2. The samplerates of 2.0 and 3.0 are the clock's, and not in any descriptor.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from device.usb.descriptors.blocks import Block, Descriptor, Reader
from device.usb.descriptors.names import named_bits

TYPE_I, EXTENDED_TYPE_I = 0x01, 0x81

_FORMAT_TYPES = {
    0x01: "type I",
    0x02: "type II",
    0x03: "type III",
    0x04: "type IV",
    0x81: "extended type I",
    0x82: "extended type II",
    0x83: "extended type III",
}

_ENCODINGS_1 = {
    0x0000: "undefined",
    0x0001: "PCM",
    0x0002: "PCM8",
    0x0003: "IEEE float",
    0x0004: "A-law",
    0x0005: "mu-law",
    0x1001: "MPEG",
    0x1002: "AC-3",
}

_ENCODINGS_2 = {0: "PCM", 1: "PCM8", 2: "IEEE float", 3: "A-law", 4: "mu-law", 31: "raw data"}
_ENCODINGS_3 = {**_ENCODINGS_2, 5: "DSD", 6: "raw data", 31: "format bit 31"}

SUBSLOT_BYTES = range(1, 5)


@dataclass(frozen=True, slots=True)
class RateRange:
    """All sample rates from a lowest to a highest rate.

    Attributes
    ----------
    lowest, highest : int
        Hz.
    """

    lowest: int
    highest: int


@dataclass(frozen=True, slots=True)
class StreamGeneral(Descriptor):
    """What flows through an alternate setting.

    uac: 1 or 2. terminal_link: the terminal of the function that it is. formats: wFormatTag (1.0)
    or bmFormats (2.0). delay_frames: of the data path in USB frames, of 1.0. format_type,
    channels, channel_config: of 2.0 (in 1.0 they are the format's and the terminal's).
    """

    uac: int
    terminal_link: int
    formats: int
    delay_frames: int | None
    format_type: int | None
    channels: int | None
    channel_config: int | None

    kind: ClassVar[str] = "streaming general"

    @property
    def encodings(self) -> tuple[str, ...]:
        """What the bytes of a sample mean: "PCM", "IEEE float" and so on."""
        if self.uac == 1:
            return (_ENCODINGS_1.get(self.formats) or f"format 0x{self.formats:04x}",)
        return named_bits(self.formats, _ENCODINGS_2, "format bit")


@dataclass(frozen=True, slots=True)
class StreamGeneral3(Descriptor):
    """What flows through an alternate setting of 3.0.

    terminal_link, formats: as in `StreamGeneral`. cluster: the number that its channels are asked
    by. subslot_bytes, bits: as in `StreamFormat`.
    """

    terminal_link: int
    cluster: int
    formats: int
    subslot_bytes: int
    bits: int

    kind: ClassVar[str] = "UAC3 streaming general"

    @property
    def encodings(self) -> tuple[str, ...]:
        """What the bytes of a sample mean."""
        return named_bits(self.formats, _ENCODINGS_3, "format bit")


@dataclass(frozen=True, slots=True)
class StreamFormat(Descriptor):
    """How samples lie in a stream of format type I, plain or extended.

    subslot_bytes: of one sample (bSubframeSize in 1.0); bits: of those that mean something, the
    upper ones. channels: of 1.0; samplerates: Hz, of 1.0, None in 2.0.
    """

    format_type: int
    subslot_bytes: int
    bits: int
    channels: int | None
    samplerates: tuple[int, ...] | RateRange | None

    kind: ClassVar[str] = "format type I"


@dataclass(frozen=True, slots=True)
class OtherFormat(Descriptor):
    """A format without a stream of samples, type II for example; it is named and kept."""

    format_type: int

    kind: ClassVar[str] = "format"

    @property
    def title(self) -> str:
        """What a person calls it."""
        name = _FORMAT_TYPES.get(self.format_type) or f"type 0x{self.format_type:02x}"
        return f"format {name}"


@dataclass(frozen=True, slots=True)
class AudioEndpoint(Descriptor):
    """The class-specific side of a streaming endpoint.

    attributes: in 1.0 bit 0 is a samplerate control, bit 1 a pitch control; bit 7: packets are
    always full. controls: bmControls of 2.0, else 0. lock_delay: in milliseconds (unit 1) or
    samples (unit 2).
    """

    uac: int
    attributes: int
    controls: int
    lock_delay_unit: int
    lock_delay: int

    @property
    def samplerate_settable(self) -> bool:
        """Whether the samplerate is set at this endpoint; never in 2.0."""
        return self.uac == 1 and bool(self.attributes & 1)


def _endpoint(block: Block, uac: int) -> AudioEndpoint | None:
    if not block.holds(6 + uac):
        return None
    controls = block.raw[4] if uac == 2 else 0
    unit, delay = block.raw[3 + uac], block.u16(4 + uac)
    return AudioEndpoint(block.offset, block.raw, uac, block.raw[3], controls, unit, delay)


def _general_1(block: Block) -> StreamGeneral | None:
    if not block.holds(7):
        return None
    link, delay = block.raw[3:5]
    return StreamGeneral(block.offset, block.raw, 1, link, block.u16(5), delay, None, None, None)


def _general_2(block: Block) -> StreamGeneral | None:
    if not block.holds(16):
        return None
    link, _, format_type = block.raw[3:6]
    formats, channels, channel_config = block.u32(6), block.raw[10], block.u32(11)
    return StreamGeneral(
        block.offset, block.raw, 2, link, formats, None, format_type, channels, channel_config
    )


def _general_3(block: Block) -> StreamGeneral3 | None:
    if not block.holds(23):
        return None
    cluster, formats = block.u16(8), block.u32(10) | block.u32(14) << 32
    link, subslot_bytes, bits = block.raw[3], block.raw[18], block.raw[19]
    return StreamGeneral3(block.offset, block.raw, link, cluster, formats, subslot_bytes, bits)


def _format_1(block: Block) -> Descriptor | None:
    if not block.holds(4):
        return None
    if block.raw[3] != TYPE_I:
        return OtherFormat(block.offset, block.raw, block.raw[3])
    if not block.holds(8):
        return None
    channels, subslot_bytes, bits = block.raw[4:7]
    if not channels:
        block.note("bNrChannels is 0", "1 to 255")
    _check_sample(block, "bSubframeSize", subslot_bytes, bits)
    return StreamFormat(
        block.offset, block.raw, TYPE_I, subslot_bytes, bits, channels, _samplerates(block)
    )


def _samplerates(block: Block) -> tuple[int, ...] | RateRange:
    """The samplerates as they are written, as many as there are."""
    count, room = block.raw[7], (len(block.raw) - 8) // 3
    if not count and room >= 2:
        lowest, highest = block.u24(8), block.u24(11)
        if not 0 < lowest <= highest:
            block.note(f"samplerates from {lowest} to {highest} Hz", "from 1 Hz on, upwards")
        return RateRange(lowest, highest)
    if not count:
        block.note(f"bSamFreqType is 0 (a range), with room for {room} samplerates", "room for 2")
    elif count > room:
        block.note(f"bSamFreqType is {count}", f"1 to {room}, which its length leaves room for")
    rates = tuple(block.u24(8 + 3 * place) for place in range(min(count, room)))
    if 0 in rates:
        block.note("a samplerate of 0 Hz", "1 Hz or more")
    return rates


def _format_2(block: Block) -> Descriptor | None:
    if not block.holds(4):
        return None
    if block.raw[3] not in (TYPE_I, EXTENDED_TYPE_I):
        return OtherFormat(block.offset, block.raw, block.raw[3])
    if not block.holds(6):
        return None
    format_type, subslot_bytes, bits = block.raw[3:6]
    _check_sample(block, "bSubslotSize", subslot_bytes, bits)
    return StreamFormat(block.offset, block.raw, format_type, subslot_bytes, bits, None, None)


def _check_sample(block: Block, field: str, subslot_bytes: int, bits: int) -> None:
    if subslot_bytes not in SUBSLOT_BYTES:
        block.note(f"{field} is {subslot_bytes}", "1 to 4 bytes")
    elif not 0 < bits <= 8 * subslot_bytes:
        block.note(
            f"bBitResolution is {bits}", f"1 to {8 * subslot_bytes} in {subslot_bytes} bytes"
        )


STREAMING_READERS: dict[int, dict[int, tuple[str, Reader]]] = {
    1: {1: (StreamGeneral.kind, _general_1), 2: (StreamFormat.kind, _format_1)},
    2: {1: (StreamGeneral.kind, _general_2), 2: (StreamFormat.kind, _format_2)},
    3: {1: (StreamGeneral3.kind, _general_3)},
}
"""By version and bDescriptorSubtype; others (format-specific, encoder, decoder) are only named."""

ENDPOINT_READERS: dict[int, Reader] = {uac: partial(_endpoint, uac=uac) for uac in (1, 2)}
"""By version."""
