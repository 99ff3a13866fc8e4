"""A USB audio device's control endpoint in software: descriptors, strings, volume, mute, rate.

Standard library only: it also runs under the system's Python. Sources: USB 2.0, chapter 9; USB
Audio 1.0, 5.2; 2.0, 5.2.
"""

import struct
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field

STANDARD, CLASS = 0x00, 0x20
GET_STATUS, CLEAR_FEATURE, SET_FEATURE, GET_DESCRIPTOR = 0, 1, 3, 6
GET_CONFIGURATION, SET_CONFIGURATION, GET_INTERFACE, SET_INTERFACE = 8, 9, 10, 11
DEVICE, CONFIGURATION, STRING, QUALIFIER = 1, 2, 3, 6
US_ENGLISH = 0x0409

REQUESTS_1 = {0x01: "set", 0x81: "now", 0x82: "lowest", 0x83: "highest", 0x84: "step"}
CUR_2 = 0x01
REQUESTS_2 = {CUR_2: "now", 0x02: "range"}
POWER_DOMAINS, POWER_STATE = (0x0A, 0x0B), 0x02
"""Of a basic profile of class 3 (Basic Audio Device 3.0, 5.2.1), whose requests are of class 2."""
MUTE, VOLUME, SAMPLERATE, VALID = 0x01, 0x02, 0x01, 0x02


@dataclass(eq=False)
class SoftwareDac:
    """What a DAC answers. `None` is a stall.

    volumes: 1/256 dB by channel; volume_range: lowest, highest, step; mute: by channel. unit,
    clock: ids of the feature unit and the clock source; endpoint: address that takes samples.
    stalls: every class request is refused; keeps_volume: every new volume is; ignores: a volume is
    taken, and stays what it was. real_range: where it differs from the range that it tells.
    log: (request type, request, value, index, data).
    """

    descriptors: bytes
    uac: int
    strings: Sequence[str]
    _: KW_ONLY
    unit: int = 2
    clock: int = 4
    endpoint: int = 0x01
    samplerates: Sequence[int] = (44_100, 48_000)
    volume_range: tuple[int, int, int] = (-0x4000, 0, 0x80)
    volumes: dict[int, int] = field(default_factory=lambda: {1: -0x800, 2: -0x800})
    mutes: dict[int, int] = field(default_factory=lambda: {0: 0})
    stalls: bool = False
    keeps_volume: bool = False
    ignores: bool = False
    real_range: tuple[int, int] | None = None
    log: list[tuple[int, int, int, int, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.samplerate = self.samplerates[0]
        self.volumes, self.mutes = dict(self.volumes), dict(self.mutes)

    def control(self, setup: bytes, data: bytes) -> bytes | None:
        """One control transfer: what comes back, b"" where that is nothing, None for a stall."""
        request_type, request, value, index, length = struct.unpack("<BBHHH", setup)
        self.log.append((request_type, request, value, index, data.hex()))
        if request_type & 0x60 == STANDARD:
            answer = self._standard(request, value)
        elif self.stalls:
            return None
        else:
            answer = self._of_class(request_type, request, value, index, data)
        return None if answer is None else answer[:length]

    def _standard(self, request: int, value: int) -> bytes | None:
        if request == GET_STATUS:
            return b"\0\0"
        if request in (SET_CONFIGURATION, SET_INTERFACE, CLEAR_FEATURE, SET_FEATURE):
            return b""
        if request in (GET_CONFIGURATION, GET_INTERFACE):
            return b"\1" if request == GET_CONFIGURATION else b"\0"
        if request != GET_DESCRIPTOR:
            return None
        kind, number = value >> 8, value & 0xFF
        if kind == DEVICE:
            return self.descriptors[:18]
        if kind == CONFIGURATION:
            return self._configuration(number)
        if kind == QUALIFIER and self.uac > 1:
            return bytes([10, QUALIFIER]) + self.descriptors[2:8] + b"\1\0"
        if kind == STRING and number == 0:
            return struct.pack("<BBH", 4, STRING, US_ENGLISH)
        if kind == STRING and number <= len(self.strings):
            text = self.strings[number - 1].encode("utf-16-le")
            return bytes([2 + len(text), STRING]) + text
        return None

    def _configuration(self, number: int) -> bytes | None:
        rest = self.descriptors[18:]
        for _ in range(number):
            rest = rest[int.from_bytes(rest[2:4], "little") :]
        another = len(self.descriptors) > 17 and self.descriptors[17] > 1
        return (rest[: int.from_bytes(rest[2:4], "little")] if another else rest) or None

    def _of_class(
        self, request_type: int, request: int, value: int, index: int, data: bytes
    ) -> bytes | None:
        control, channel, entity = value >> 8, value & 0xFF, index >> 8
        asks = bool(request_type & 0x80)
        of_endpoint = self.uac == 1 and request_type & 0x1F == 2
        if self.uac == 1:
            what = REQUESTS_1.get(request, "")
            of_clock = of_endpoint and index & 0xFF == self.endpoint
        else:
            what = (REQUESTS_2 if asks else {CUR_2: "set"}).get(request, "")
            of_clock = entity == self.clock
            if of_clock and control == VALID:
                return b"\1" if what == "now" else None
            if entity in POWER_DOMAINS and control == POWER_STATE and request == CUR_2:
                return b"\0" if asks else b""  # fully on, whatever is set
        if of_clock and control == SAMPLERATE:
            return self._rate(what, data)
        if of_endpoint or entity != self.unit:
            return None
        if control == VOLUME and channel in self.volumes:
            return self._volume(what, channel, data)
        if control != MUTE or channel not in self.mutes:
            return None
        if what == "set" and data:
            self.mutes[channel] = data[0]
            return b""
        return bytes([self.mutes[channel]]) if what == "now" else None

    def _volume(self, what: str, channel: int, data: bytes) -> bytes | None:
        if what == "range":
            return struct.pack("<Hhhh", 1, *self.volume_range)
        if what != "set":
            told = dict(zip(("lowest", "highest", "step"), self.volume_range, strict=True))
            told["now"] = self.volumes[channel]
            return struct.pack("<h", told[what]) if what in told else None
        if len(data) != 2 or self.keeps_volume:
            return None
        if not self.ignores:
            (units,) = struct.unpack("<h", data)
            lowest, highest = self.real_range or self.volume_range[:2]
            self.volumes[channel] = units if units == -0x8000 else max(lowest, min(highest, units))
        return b""

    def _rate(self, what: str, data: bytes) -> bytes | None:
        if what == "range":
            triples = b"".join(struct.pack("<III", r, r, 0) for r in self.samplerates)
            return struct.pack("<H", len(self.samplerates)) + triples
        if what == "now":
            return self.samplerate.to_bytes(3 if self.uac == 1 else 4, "little")
        rate = int.from_bytes(data, "little")
        if what != "set" or rate not in self.samplerates:
            return None
        self.samplerate = rate
        return b""
