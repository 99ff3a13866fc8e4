"""What lies where in the page of memory that the plugin shares; plugin/native/page.h says the same.

Each value has one writer and is written at once, so no side waits for another. The daemon reads and
writes the page, a live page only reads it.
"""

from __future__ import annotations

import ctypes
import mmap
import struct

from audioflinger_hook.core.structures import (
    CHANNELS,
    PARTIALS,
    ActuatorReadings,
    Controls,
    Level,
    Readings,
)

MAGIC = 0x3545474150485543
ACTUATORS = 32  # largest number of actuators of the plugin
READ_TRIES = 4  # to read partials while the plugin writes them, which takes less than 1 µs


class Layout(ctypes.Structure):
    """The whole page."""

    _fields_ = (
        ("magic", ctypes.c_uint64),
        ("size", ctypes.c_uint64),
        ("samplerate", ctypes.c_uint64),
        ("cycle_frames", ctypes.c_uint64),
        ("controls", Controls),
        ("readings", Readings),
    )


SIZE = ctypes.sizeof(Layout)

_HEADER = struct.Struct("=2Q")
_COUNT, _FRAMES_AT = struct.Struct("=Q"), Layout.readings.offset + Readings.frames.offset
_SEQUENCE_AT = Layout.readings.offset + Readings.sequence.offset
_SHOWN_AT = Layout.readings.offset + Readings.sound.offset
_LEVEL_BYTES = ctypes.sizeof(Level)
_AFTER_LEVEL = ctypes.sizeof(ActuatorReadings) - _LEVEL_BYTES


# Counts of channels, actuators and partials, and their numbers: peak and mean square of each
# channel and each actuator; Hz of the sound, Hz of vibration and amplitude of each partial.
Shown = tuple[tuple[int, int, int], tuple[float, ...]]


class ShownReader:
    """Reads what a live page shows of a shared page; any thread may call it."""

    def __init__(self, memory: mmap.mmap, channels: int, actuators: int) -> None:
        self._memory = memory
        self.channels, self.actuators = channels, actuators
        # Read with one call, as a page asks many times a second.
        self._shown = struct.Struct(
            f"={2 * channels}d{_LEVEL_BYTES * (2 * CHANNELS - channels)}x2Q{3 * PARTIALS}d"
            + f"2d{_AFTER_LEVEL}x" * actuators
        )

    @property
    def is_known(self) -> bool:
        """Whether the memory is a page of this layout."""
        return len(self._memory) == SIZE and _HEADER.unpack_from(self._memory) == (MAGIC, SIZE)

    @property
    def frames(self) -> int:
        """Frames of sound that were processed; it stands still while nothing plays."""
        return int(_COUNT.unpack_from(self._memory, _FRAMES_AT)[0])

    @property
    def sequence(self) -> int:
        """A count that changes when partials are written."""
        return int(_COUNT.unpack_from(self._memory, _SEQUENCE_AT)[0])

    def shown(self) -> Shown:
        """Return what a page shows; no partials where the plugin writes at every attempt."""
        first = 2 * self.channels
        partials = first + 2
        for _ in range(READ_TRIES):
            found = self._shown.unpack_from(self._memory, _SHOWN_AT)
            (again,) = _COUNT.unpack_from(self._memory, _SEQUENCE_AT)
            if found[first] == again and not again % 2:
                count = min(found[first + 1], PARTIALS)
                break
        else:
            count = 0
        actuators, shown = found[partials + 3 * PARTIALS :], found[partials : partials + 3 * count]
        return (self.channels, self.actuators, count), (*found[:first], *actuators, *shown)
