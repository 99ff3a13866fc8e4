"""USB control transfers for volume, mute and samplerate, and the decoding of their answers.

Pure functions. In a transfer, a volume is a signed 16-bit number in units of 1/256 dB; -32768 is
silence. Sources: section 5.2 of USB Audio 1.0 and of USB Audio 2.0.
"""

import math
import struct
from dataclasses import dataclass, replace
from typing import Literal

from device.errors import UsageError, UsbAccessError
from device.usb.descriptors import PlaybackFormat, RateRange
from device.usb.descriptors.audio_class import VOLUME_UNITS_PER_DB, FeatureControl
from device.volume_limit import MAX_VOLUME_DB, limit_volume_db

What = Literal["now", "range", "lowest", "highest", "step"]

SILENCE_UNITS = -32_768

# bmRequestType of a query: to the host, of the class, for an interface or an endpoint
_INTERFACE, _ENDPOINT = 0xA1, 0xA2
_TO_HOST = 0x80
_GET_1: dict[What, int] = {"now": 0x81, "lowest": 0x82, "highest": 0x83, "step": 0x84}
_GET_2: dict[What, int] = {"now": 0x01, "range": 0x02}
_SET = 0x01
_SAMPLERATE = 0x01 << 8
_MOST_RANGES = 32  # most ranges that are read from an answer; limits its length


@dataclass(frozen=True)
class Request:
    """One control transfer. length: bytes sent or received. data: bytes sent; None for a query."""

    request_type: int
    request: int
    value: int
    index: int
    length: int
    data: bytes | None = None

    def setting(self, value: int, *, signed: bool = False) -> "Request":
        """Return the request that sets what this request queries."""
        data = value.to_bytes(self.length, "little", signed=signed)
        return replace(self, request_type=self.request_type & ~_TO_HOST, request=_SET, data=data)


@dataclass(frozen=True)
class VolumeRange:
    """The range and the step of a volume control."""

    lowest_db: float
    highest_db: float
    step_db: float

    def allowed(self, wanted_db: float, limit_db: float = MAX_VOLUME_DB) -> float:
        """Return the highest settable volume that exceeds none of wanted_db, limit_db and 0 dB.

        If wanted_db is below the range, the result is lowest_db.
        UsageError: wanted_db is NaN, or lowest_db is above limit_db or 0 dB.
        """
        most_db = limit_volume_db(wanted_db, self.lowest_db, "the device", limit_db)
        steps = math.floor((min(most_db, self.highest_db) - self.lowest_db) / self.step_db + 1e-9)
        return self.lowest_db + max(0, steps) * self.step_db


def feature(
    playback: PlaybackFormat, control: FeatureControl, channel: int, what: What = "now"
) -> Request:
    """Return the query of a channel's volume or mute. UsbAccessError: there is no feature unit."""
    length = 1 if control is FeatureControl.MUTE else 2
    if what == "range":
        length = 2 + 3 * length * _MOST_RANGES
    value = (control + 1) << 8 | channel
    index = _unit_index(playback, playback.feature_unit, "volume or mute")
    get = _GET_1 if playback.uac == 1 else _GET_2
    return Request(_INTERFACE, get[what], value, index, length)


def set_feature(
    playback: PlaybackFormat, control: FeatureControl, channel: int, value: int
) -> Request:
    """Return the request that sets a volume in 1/256 dB, or a mute: 1 is muted, 0 is not."""
    asked = feature(playback, control, channel)
    return asked.setting(value, signed=control is not FeatureControl.MUTE)


def samplerate(playback: PlaybackFormat, what: What = "now") -> Request:
    """Return the query of the samplerate or its range. UsbAccessError: no query is possible."""
    if playback.uac == 1 and what != "now":
        raise UsbAccessError("a device of USB Audio 1.0 lists its samplerates in its descriptors")
    if playback.uac == 1:
        return Request(_ENDPOINT, _GET_1[what], _SAMPLERATE, playback.endpoint_address, 3)
    if len(playback.clock_sources) > 1:
        raise UsbAccessError(
            f"the device can use any of the clocks {playback.clock_sources}; the clock in use is "
            "not known, so none is read"
        )
    index = _unit_index(playback, next(iter(playback.clock_sources), None), "a clock")
    length = 4 if what == "now" else 2 + 12 * _MOST_RANGES
    return Request(_INTERFACE, _GET_2[what], _SAMPLERATE, index, length)


def set_samplerate(playback: PlaybackFormat, hertz: int) -> Request:
    """Return the request that sets the samplerate in Hz. UsageError: the rate is out of range."""
    asked = samplerate(playback)
    if not 0 < hertz < 1 << 8 * min(3, asked.length):
        raise UsageError(f"samplerate {hertz} Hz is not possible; choose one that is offered")
    return asked.setting(hertz)


def from_volume_units(units: int) -> float:
    """Convert a volume from 1/256 dB to dB; -inf is silence."""
    return -math.inf if units == SILENCE_UNITS else units / VOLUME_UNITS_PER_DB


def volume_units(decibels: float) -> int:
    """Convert a volume from dB to 1/256 dB, rounded down; -inf is silence."""
    if decibels == -math.inf:
        return SILENCE_UNITS
    return max(SILENCE_UNITS + 1, min(32_767, math.floor(decibels * VOLUME_UNITS_PER_DB + 1e-6)))


def volume_range(*answers: bytes) -> VolumeRange:
    """Decode the lowest, the highest and the step (USB Audio 1.0), or one answer with all ranges.

    The ranges are united. UsbAccessError: an answer is invalid.
    """
    name = "volume range"
    if len(answers) == 1:
        triples = _ranges(name, answers[0], "<hhh")
    else:
        triples = [tuple(number(answer, 2, name, signed=True) for answer in answers)]
    lowest = min(low for low, _, _ in triples)
    highest = max(high for _, high, _ in triples)
    if lowest > highest:
        raise UsbAccessError(
            f"the device offers volumes from {lowest / VOLUME_UNITS_PER_DB:g} to "
            f"{highest / VOLUME_UNITS_PER_DB:g} dB, not a valid range; its volume is not changed"
        )
    # -32768 is silence, not a volume in dB.
    lowest = max(lowest, SILENCE_UNITS + 1)
    step = max(1, *(step for _, _, step in triples))
    return VolumeRange(*(units / VOLUME_UNITS_PER_DB for units in (lowest, highest, step)))


def samplerate_ranges(answer: bytes) -> tuple[RateRange, ...]:
    """Decode a clock's samplerates (USB Audio 2.0), in Hz; a single rate is a range, too."""
    return tuple(
        RateRange(lowest, highest)
        for lowest, highest, _ in _ranges("samplerates", answer, "<III")
        if 0 < lowest <= highest
    )


def number(answer: bytes, length: int, name: str = "number", *, signed: bool = False) -> int:
    """Decode an integer at the start of an answer. UsbAccessError: the answer is too short."""
    if len(answer) < length:
        raise UsbAccessError(
            f"the device answers {answer.hex(' ') or 'nothing'} where its {name} needs {length} "
            "bytes"
        )
    return int.from_bytes(answer[:length], "little", signed=signed)


def _ranges(name: str, answer: bytes, layout: str) -> list[tuple[int, ...]]:
    """Return all complete triples (lowest, highest, step) in the answer to a RANGE request."""
    size = struct.calcsize(layout)
    whole = min(number(answer, 2, name), (len(answer) - 2) // size)
    if not whole:
        raise UsbAccessError(f"the device offers no {name}: {answer.hex(' ')}")
    return [struct.unpack_from(layout, answer, 2 + size * each) for each in range(whole)]


def _unit_index(playback: PlaybackFormat, unit: int | None, name: str) -> int:
    if unit is None or playback.control_interface is None:
        raise UsbAccessError(f"the device has no {name} that can be asked")
    return unit << 8 | playback.control_interface
