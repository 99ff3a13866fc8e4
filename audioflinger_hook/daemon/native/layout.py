"""Layout of shared memory, as in plugin/native/parts.h. No value is written by two processes."""

import ctypes
import mmap
import struct

from audioflinger_hook.core import structures
from audioflinger_hook.core.structures import CHANNELS, PARTIALS, Controls, Level, Readings

MAGIC = 0x3645474150485543
BANKS = 2  # design n uses bank n % BANKS
ACTUATORS = 32  # largest number of actuators of the plugin


class Bank(ctypes.Structure):
    """Controls and readings of one design."""

    _fields_ = (("controls", Controls), ("readings", Readings))


_NUMBERS = ("magic", "size", "samplerate", "cycle_frames", "wanted", "playing", "refused")


class Layout(ctypes.Structure):
    """Layout of the shared memory."""

    _fields_ = (*((name, ctypes.c_uint64) for name in _NUMBERS), ("banks", Bank * BANKS))


SIZE = ctypes.sizeof(Layout)

_HEADER = struct.Struct("=2Q")
_COUNT = struct.Struct("=Q")
_FRAMES_AT = Bank.readings.offset + Readings.frames.offset
_SEQUENCE_AT = Bank.readings.offset + Readings.sequence.offset
_SHOWN_AT = Bank.readings.offset + Readings.sound.offset
_LEVEL_BYTES = ctypes.sizeof(Level)
_AFTER_LEVEL = ctypes.sizeof(structures.ActuatorReadings) - _LEVEL_BYTES


# Numbers of channels, actuators and partials, then values. A channel or actuator has peak and mean
# square. A partial has frequency in the sound in Hz, frequency in the vibration in Hz, amplitude.
Shown = tuple[tuple[int, int, int], tuple[float, ...]]


class ShownReader:
    """Reads levels and partials from shared memory for the live page. Any thread may use it."""

    def __init__(self, memory: mmap.mmap, channels: int, actuators: int) -> None:
        self._memory = memory
        self.channels, self.actuators = channels, actuators
        # One call reads all values, because pages read them many times per second.
        self._shown = struct.Struct(
            f"={2 * channels}d{_LEVEL_BYTES * (2 * CHANNELS - channels)}x2Q{3 * PARTIALS}d"
            + f"2d{_AFTER_LEVEL}x" * actuators
        )

    @property
    def is_known(self) -> bool:
        """Whether the memory has the layout `Layout`."""
        return len(self._memory) == SIZE and _HEADER.unpack_from(self._memory) == (MAGIC, SIZE)

    @property
    def frames(self) -> int:
        """Number of frames that the playing design has processed."""
        return int(_COUNT.unpack_from(self._memory, self._bank_at + _FRAMES_AT)[0])

    @property
    def sequence(self) -> int:
        """Counter that changes at each write of partials; odd during a write."""
        return int(_COUNT.unpack_from(self._memory, self._bank_at + _SEQUENCE_AT)[0])

    def shown(self) -> Shown:
        """Return levels and partials; no partials if each attempt coincides with a write."""
        first = 2 * self.channels
        partials, bank_at = first + 2, self._bank_at
        for _ in range(4):  # the plugin may write meanwhile
            found = self._shown.unpack_from(self._memory, bank_at + _SHOWN_AT)
            (again,) = _COUNT.unpack_from(self._memory, bank_at + _SEQUENCE_AT)
            if found[first] == again and not again % 2:
                count = min(found[first + 1], PARTIALS)
                break
        else:
            count = 0
        actuators, shown = found[partials + 3 * PARTIALS :], found[partials : partials + 3 * count]
        return (self.channels, self.actuators, count), (*found[:first], *actuators, *shown)

    @property
    def _bank_at(self) -> int:
        (playing,) = _COUNT.unpack_from(self._memory, Layout.playing.offset)
        return Layout.banks.offset + int(playing) % BANKS * ctypes.sizeof(Bank)
