"""A USB audio device's control endpoint in software: descriptors, strings, volume, mute, rate.

Standard library only: it also runs under the system's Python. Sources: USB 2.0, chapter 9; USB
Audio 1.0, 5.2; 2.0, 5.2.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

STANDARD, CLASS = 0x00, 0x20
GET_STATUS, CLEAR_FEATURE, SET_FEATURE, GET_DESCRIPTOR = 0, 1, 3, 6
GET_CONFIGURATION, SET_CONFIGURATION, GET_INTERFACE, SET_INTERFACE = 8, 9, 10, 11
DEVICE, CONFIGURATION, STRING, QUALIFIER = 1, 2, 3, 6
US_ENGLISH = 0x0409

CUR_1, MIN_1, MAX_1, RES_1 = 0x81, 0x82, 0x83, 0x84
SET_CUR, CUR_2, RANGE_2 = 0x01, 0x01, 0x02
POWER_DOMAINS, POWER_STATE = (0x0A, 0x0B), 0x02
"""Of a basic profile of class 3 (Basic Audio Device 3.0, 5.2.1), whose requests are of class 2."""
MUTE, VOLUME, SAMPLERATE, VALID = 0x01, 0x02, 0x01, 0x02


class SoftwareDac:
    """What a DAC answers. `None` is a stall.

    volumes: 1/256 dB by channel; volume_range: lowest, highest, step; mute: by channel. unit,
    clock: ids of the feature unit and the clock source; endpoint: address that takes samples.
    stalls: every class request is refused; keeps_volume: every new volume is; ignores: a volume is
    taken, and stays what it was. real_range: where it differs from the range that it tells.
    log: (request type, request, value, index, data).
    """

    def __init__(
        self,
        descriptors: bytes,
        uac: int,
        strings: Sequence[str],
        *,
        unit: int = 2,
        clock: int = 4,
        endpoint: int = 0x01,
        samplerates: Sequence[int] = (44_100, 48_000),
        volume_range: tuple[int, int, int] = (-0x4000, 0, 0x80),
        volumes: dict[int, int] | None = None,
        mutes: dict[int, int] | None = None,
        stalls: bool = False,
        keeps_volume: bool = False,
        ignores: bool = False,
    ) -> None:
        self.descriptors = descriptors
        self.uac = uac
        self.strings = tuple(strings)
        self.unit, self.clock, self.endpoint = unit, clock, endpoint
        self.samplerates = tuple(samplerates)
        self.samplerate = self.samplerates[0]
        self.volume_range = volume_range
        self.volumes = {1: -0x800, 2: -0x800} if volumes is None else dict(volumes)
        self.mutes = {0: 0} if mutes is None else dict(mutes)
        self.stalls, self.keeps_volume, self.ignores = stalls, keeps_volume, ignores
        self.real_range: tuple[int, int] | None = None
        self.log: list[tuple[int, int, int, int, str]] = []

    def control(self, setup: bytes, data: bytes) -> bytes | None:
        """One control transfer: what comes back, b"" where that is nothing, None for a stall."""
        request_type, request, value, index, length = struct.unpack("<BBHHH", setup)
        self.log.append((request_type, request, value, index, data.hex()))
        if request_type & 0x60 == STANDARD:
            answer = self._standard(request, value)
        elif self.stalls:
            return None
        else:
            of_device = self._class_1 if self.uac == 1 else self._class_2
            answer = of_device(request_type, request, value, index, data)
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

    def _class_1(
        self, request_type: int, request: int, value: int, index: int, data: bytes
    ) -> bytes | None:
        control, channel = value >> 8, value & 0xFF
        if request_type & 0x1F == 2:  # an endpoint
            if control != SAMPLERATE or index & 0xFF != self.endpoint:
                return None
            if request == CUR_1:
                return self.samplerate.to_bytes(3, "little")
            return self._set_rate(data) if request == SET_CUR else None
        if index >> 8 != self.unit:
            return None
        lowest, highest, step = self.volume_range
        if control == VOLUME and channel in self.volumes:
            if request == SET_CUR:
                return self._set_volume(channel, data)
            told = {CUR_1: self.volumes[channel], MIN_1: lowest, MAX_1: highest, RES_1: step}
            return struct.pack("<h", told[request]) if request in told else None
        return self._mute(request == CUR_1, request == SET_CUR, control, channel, data)

    def _class_2(
        self, request_type: int, request: int, value: int, index: int, data: bytes
    ) -> bytes | None:
        control, channel, entity = value >> 8, value & 0xFF, index >> 8
        asks = bool(request_type & 0x80)
        if entity == self.clock and control == VALID:
            return b"\1" if asks and request == CUR_2 else None
        if entity == self.clock and control == SAMPLERATE:
            if request == RANGE_2 and asks:
                triples = b"".join(struct.pack("<III", r, r, 0) for r in self.samplerates)
                return struct.pack("<H", len(self.samplerates)) + triples
            if request != CUR_2:
                return None
            return self.samplerate.to_bytes(4, "little") if asks else self._set_rate(data)
        if entity in POWER_DOMAINS and control == POWER_STATE and request == CUR_2:
            return b"\0" if asks else b""  # fully on, whatever is set
        if entity != self.unit:
            return None
        if control == VOLUME and channel in self.volumes:
            if request == RANGE_2 and asks:
                return struct.pack("<Hhhh", 1, *self.volume_range)
            if request == CUR_2:
                told = struct.pack("<h", self.volumes[channel])
                return told if asks else self._set_volume(channel, data)
            return None
        return self._mute(
            asks and request == CUR_2, not asks and request == CUR_2, control, channel, data
        )

    def _mute(
        self, asks: bool, sets: bool, control: int, channel: int, data: bytes
    ) -> bytes | None:
        if control != MUTE or channel not in self.mutes:
            return None
        if sets and data:
            self.mutes[channel] = data[0]
            return b""
        return bytes([self.mutes[channel]]) if asks else None

    def _set_volume(self, channel: int, data: bytes) -> bytes | None:
        if len(data) != 2 or self.keeps_volume:
            return None
        if self.ignores:
            return b""
        (units,) = struct.unpack("<h", data)
        lowest, highest = self.real_range or self.volume_range[:2]
        self.volumes[channel] = units if units == -0x8000 else max(lowest, min(highest, units))
        return b""

    def _set_rate(self, data: bytes) -> bytes | None:
        rate = int.from_bytes(data, "little")
        if rate not in self.samplerates:
            return None
        self.samplerate = rate
        return b""
