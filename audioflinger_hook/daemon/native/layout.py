"""What lies where in the page of memory that the plugin shares; plugin/native/page.h says the same.

Each value has one writer and is written at once, so no side waits for another. The daemon reads and
writes the page, a live page only reads it.
"""

from __future__ import annotations

import ctypes
import mmap
import struct

MAGIC = 0x3445474150485543
CHANNELS = 8
"""Largest number of channels of a tap, and of vibrations."""

ACTUATORS = 32
PARTIALS = 16
READ_TRIES = 4
"""Attempts to read the partials while the plugin writes; writing takes less than 1 µs."""


class _TransformWishes(ctypes.Structure):
    _fields_ = (
        ("channels", ctypes.c_uint64),
        ("outputs", ctypes.c_uint64),
        ("mixed", ctypes.c_uint64),
        ("weights", ctypes.c_double * CHANNELS * 2 * CHANNELS),
    )


class _TransformReadings(ctypes.Structure):
    _fields_ = (
        ("frames", ctypes.c_uint64),
        ("replaced", ctypes.c_uint64),
        ("limited", ctypes.c_uint64),
        ("samplerate", ctypes.c_uint64),
        ("cycle_frames", ctypes.c_uint64),
        ("sound_peak", ctypes.c_double),
        ("sound_square", ctypes.c_double),
        ("vibration_peak", ctypes.c_double),
        ("vibration_square", ctypes.c_double),
        ("channels", ctypes.c_double * 2 * CHANNELS),
    )


class _PartialReadings(ctypes.Structure):
    _fields_ = (
        ("sequence", ctypes.c_uint64),
        ("count", ctypes.c_uint64),
        ("partials", ctypes.c_double * 3 * PARTIALS),
    )


class _ActuatorWishes(ctypes.Structure):
    _fields_ = (
        ("gain", ctypes.c_double),
        ("delay_s", ctypes.c_double),
        ("audible", ctypes.c_uint64),
        ("damped", ctypes.c_uint64),
        ("damping_gain", ctypes.c_double),
        ("section", ctypes.c_double * 6),
    )


class _ActuatorReadings(ctypes.Structure):
    _fields_ = (
        ("frames", ctypes.c_uint64),
        ("peak", ctypes.c_double),
        ("square", ctypes.c_double),
        ("audible", ctypes.c_double),
    )


class Layout(ctypes.Structure):
    """The whole page."""

    _fields_ = (
        ("magic", ctypes.c_uint64),
        ("size", ctypes.c_uint64),
        ("sound_gain", ctypes.c_double),
        ("transform", _TransformWishes),
        ("readings", _TransformReadings),
        ("partials", _PartialReadings),
        ("wishes", _ActuatorWishes * ACTUATORS),
        ("actuators", _ActuatorReadings * ACTUATORS),
    )


SIZE = ctypes.sizeof(Layout)

_HEADER = struct.Struct("=2Q")
_COUNT, _FRAMES_AT = struct.Struct("=Q"), Layout.readings.offset
_SEQUENCE_AT = Layout.partials.offset
_SHOWN_AT = Layout.readings.offset + _TransformReadings.channels.offset
_BETWEEN = Layout.actuators.offset - _SEQUENCE_AT - ctypes.sizeof(_PartialReadings)


Shown = tuple[tuple[int, int, int], tuple[float, ...]]
"""Counts of channels, actuators and partials, and their numbers: peak and mean square of each
channel and each actuator; Hz of the sound, Hz of vibration and amplitude of each partial."""


class ShownReader:
    """Reads what a live page shows; any thread may call it.

    memory: the shared page. channels: of the tap, 1 to CHANNELS. actuators: 1 to ACTUATORS.
    """

    def __init__(self, memory: mmap.mmap, channels: int, actuators: int) -> None:
        self._memory = memory
        self.channels, self.actuators = channels, actuators
        # Read with one call, as a page asks many times a second.
        self._shown = struct.Struct(
            f"={2 * channels}d{16 * (CHANNELS - channels)}x2Q{3 * PARTIALS}d{_BETWEEN}x"
            + "8x2d8x" * actuators
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
        numbers = (
            *found[:first],
            *found[partials + 3 * PARTIALS :],
            *found[partials : partials + 3 * count],
        )
        return (self.channels, self.actuators, count), numbers
