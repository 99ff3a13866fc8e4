"""A sound card's control file in software: a volume in dB, a mute, a control of another kind.

Standard library only: it also runs under the system's Python. Laid out as <sound/asound.h> says
for 64 bits; written from it a second time, so that a slip in the program is not repeated here.
"""

import errno
import struct
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

LIST, INFO, READ, WRITE, TABLE = 0xC0505510, 0xC1105511, 0xC4C85512, 0xC4C85513, 0xC008551A
MIXER, PCM = 2, 3
BOOLEAN, INTEGER = 1, 2
READ_WRITE, TABLE_READ = 0x3, 0x10
BOUNDS, BOUNDS_MUTE = 4, 5

SWITCH, VOLUME, CHANNEL_MAP = 1, 2, 3
NAMES = {SWITCH: "PCM Playback Switch", VOLUME: "PCM Playback Volume", CHANNEL_MAP: "Playback Map"}


@dataclass(eq=False)
class SoftwareMixer:
    """What a card's mixer answers. volume: steps of 0 to 128, -64 to 0 dB; on: of the mute.

    controls: those that it has. drops: of these a value that is written is dropped, as the kernel
    does where the device refuses it. stalls: these cannot be read. lowest: of the volume's steps;
    below it the table still goes down to silence. vanishes: nothing answers after the first write.
    """

    volume: int = 112
    on: bool = True
    _: KW_ONLY
    controls: Sequence[int] = (SWITCH, VOLUME, CHANNEL_MAP)
    drops: Sequence[int] = ()
    stalls: Sequence[int] = ()
    lowest: int = 0
    vanishes: bool = False
    gone: bool = False

    def __post_init__(self) -> None:
        self.held = {SWITCH: [int(self.on)], VOLUME: [self.volume] * 2}

    def answer(self, request: int, argument: Any) -> tuple[int, int]:
        """An ioctl's result and errno. argument: of umockdev."""
        if self.gone:
            return -1, errno.ENODEV
        if request == LIST:
            return self._list(argument)
        if request == INFO:
            return self._info(argument.resolve(0, 272))
        if request in (READ, WRITE):
            return self._value(argument.resolve(0, 1_224), writes=request == WRITE)
        if request == TABLE:
            return self._table(argument)
        return -1, errno.ENOTTY

    def _list(self, argument: Any) -> tuple[int, int]:
        head = argument.resolve(0, 80)
        offset, space = struct.unpack("<II", bytes(head.retrieve())[:8])
        given = self.controls[offset : offset + space]
        head.update(8, struct.pack("<II", len(given), len(self.controls)))
        if given:
            ids = head.resolve(16, 64 * space)
            for place, number in enumerate(given):
                ids.update(64 * place, self._id(number))
        return 0, 0

    def _id(self, number: int) -> bytes:
        interface = PCM if number == CHANNEL_MAP else MIXER
        return struct.pack("<IiII44sI", number, interface, 0, 0, NAMES[number].encode(), 0)

    def _info(self, info: Any) -> tuple[int, int]:
        (number,) = struct.unpack("<I", bytes(info.retrieve())[:4])
        if number == SWITCH:
            info.update(0, self._id(number) + struct.pack("<iIIi", BOOLEAN, READ_WRITE, 1, 0))
        elif number == VOLUME:
            head = struct.pack("<iIIi", INTEGER, READ_WRITE | TABLE_READ, 2, 0)
            info.update(0, self._id(number) + head + struct.pack("<qqq", self.lowest, 128, 1))
        else:
            return -1, errno.ENOENT
        return 0, 0

    def _value(self, value: Any, *, writes: bool) -> tuple[int, int]:
        raw = bytes(value.retrieve())
        (number,) = struct.unpack("<I", raw[:4])
        held = self.held.get(number)
        if held is None:
            return -1, errno.ENOENT
        if not writes and number in self.stalls:
            return -1, errno.EPIPE
        layout = f"<{len(held)}q"
        if writes:
            self.gone = self.vanishes
            if number not in self.drops:
                held[:] = struct.unpack_from(layout, raw, 72)
        value.update(72, struct.pack(layout, *held))
        return int(writes), 0

    def _table(self, argument: Any) -> tuple[int, int]:
        asked = argument.resolve(0, 8 + 16)
        number, length = struct.unpack("<II", bytes(asked.retrieve())[:8])
        kind, lowest = (BOUNDS, 50 * (self.lowest - 128)) if self.lowest else (BOUNDS_MUTE, -6_400)
        table = struct.pack("<IIii", kind, 8, lowest, 0)
        if number != VOLUME or length < len(table):
            return -1, errno.ENXIO
        asked.update(8, table)
        return 0, 0
