"""Formats of streams: the general and the format descriptor of a streaming interface.

Source: USB Audio 1.0, 4.5.2 and Data Formats 1.0, 2.2.5; 2.0, 4.9.2 and Data Formats 2.0, 2.3;
3.0, 4.7.2. The samplerates of 2.0 and 3.0 are those of a clock and not in any descriptor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from device.usb.descriptors.blocks import Block

_TYPE_I, _EXTENDED_TYPE_I = 0x01, 0x81

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


@dataclass(frozen=True, slots=True)
class RateRange:
    """All samplerates from a lowest to a highest one.

    lowest, highest: Hz.
    """

    lowest: int
    highest: int


@dataclass(frozen=True, slots=True)
class StreamGeneral:
    """What flows through an alternate setting."""

    offset: int  # bytes from the first of the configuration
    terminal_link: int  # id of its terminal
    encodings: tuple[str, ...]  # "PCM", "IEEE float" and so on
    channels: int | None = None  # 2.0 only
    channel_config: int | None = None  # one bit a loudspeaker position; 2.0 only
    subslot_bytes: int = 0  # as in `StreamFormat`; 3.0 only
    bits: int = 0


@dataclass(frozen=True, slots=True)
class StreamFormat:
    """A format of type I, plain or extended; other types have 0 bytes."""

    subslot_bytes: int  # of a sample (bSubframeSize in 1.0)
    bits: int  # its significant upper bits
    channels: int | None = None  # 1.0 only
    samplerates: tuple[int, ...] | RateRange | None = None  # Hz; 1.0 only


def read_general(block: Block, uac: int) -> StreamGeneral | None:
    """Return the general descriptor, None if the block is too short."""
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
    """Return the format of a stream of 1.0 or 2.0, None if the block is too short."""
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
    """Return the samplerates that are present and possible."""
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
