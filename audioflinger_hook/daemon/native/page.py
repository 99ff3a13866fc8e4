"""The page of memory that the daemon and the plugin share; plugin/native/page.h has the layout.

Each value has one writer and is written at once, so neither side waits for the other.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import struct
from dataclasses import dataclass
from pathlib import Path

from audioflinger_hook.service.meters import Level, Reading, level_of
from audioflinger_hook.transform.downmix import mix_weights
from device.drive.damping import Damping
from device.units import FloatArray

MAGIC = 0x3345474150485543
CHANNELS = 8
"""Largest number of channels of a tap, and of vibrations."""

ACTUATORS = 32
PARTIALS = 16
READ_TRIES = 4
"""Attempts to read the partials while the plugin writes; writing takes less than 1 µs."""

DELAY_MAX_S = 2.0


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


class _Layout(ctypes.Structure):
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


_SEQUENCE, _SEQUENCE_AT = struct.Struct("=Q"), _Layout.partials.offset
_SHOWN_AT = _Layout.readings.offset + _TransformReadings.channels.offset
_BETWEEN = _Layout.actuators.offset - _SEQUENCE_AT - ctypes.sizeof(_PartialReadings)


Shown = tuple[tuple[int, int, int], tuple[float, ...]]
"""Counts of channels, actuators and partials, and their numbers: peak and mean square of each
channel and each actuator; Hz of the sound, Hz of vibration and amplitude of each partial."""


@dataclass(frozen=True)
class TransformReadings:
    """What the transform reports: frames so far, counts of samples, levels."""

    frames: int
    replaced_samples: int
    limited_samples: int
    sound: Level
    vibration: Level


class Page:
    """The shared page in a file of its own, which `close` removes.

    The supervising thread calls the methods; any thread may call `readings` and `level`.

    path: of the file; it must not exist. channels: of the tap. outputs: vibrations. actuators: that
    play them. weights: (channels, outputs, 2) of the sources' halves; None for the mono mix, or for
    each channel by itself.
    """

    def __init__(
        self,
        path: Path,
        channels: int,
        outputs: int,
        actuators: int,
        weights: FloatArray | None = None,
    ) -> None:
        self.path = path
        self._channels, self._actuators = channels, actuators
        # What a page shows, read with one call: it asks many times a second.
        self._shown = struct.Struct(
            f"={2 * channels}d{16 * (CHANNELS - channels)}x2Q{3 * PARTIALS}d{_BETWEEN}x"
            + "8x2d8x" * actuators
        )
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        file = os.open(path, flags, 0o600)
        try:
            os.ftruncate(file, ctypes.sizeof(_Layout))
            self._memory = mmap.mmap(file, ctypes.sizeof(_Layout))
        finally:
            os.close(file)
        self._page = page = _Layout.from_buffer(self._memory)
        page.transform.channels, page.transform.outputs = channels, outputs
        page.transform.mixed = weights is not None
        if weights is not None:
            for output in range(outputs):
                for row, numbers in enumerate(mix_weights(weights[:, output])):
                    page.transform.weights[output][row][:channels] = numbers.tolist()
        page.sound_gain = 1.0
        for wishes in page.wishes:
            wishes.gain = 1.0
        page.size, page.magic = ctypes.sizeof(_Layout), MAGIC

    def set_sound_gain(self, gain: float) -> None:
        """Set the factor on the tap's samples, 0 to 100; it changes over one buffer."""
        self._page.sound_gain = gain

    def set_actuator(self, slot: int, gain: float, delay_s: float) -> None:
        """Set an actuator's factor, -1 to 1, and its delay, 0 to DELAY_MAX_S."""
        wishes = self._page.wishes[slot]
        wishes.gain, wishes.delay_s = gain, min(max(0.0, delay_s), DELAY_MAX_S)

    def set_damping(self, slot: int, damping: Damping, samplerate: int) -> None:
        """Set an actuator's filter, before the plugin starts."""
        wishes, sections = self._page.wishes[slot], damping.sections(samplerate)
        wishes.damping_gain = damping.gain
        wishes.section[:] = sections[0] if len(sections) else (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)
        wishes.damped = 1

    def set_audible(self, audible: bool) -> None:
        """Fade all actuators in or out, within 40 ms."""
        for wishes in self._page.wishes:
            wishes.audible = int(audible)

    @property
    def frames(self) -> int:
        """Frames that the transform has processed."""
        return int(self._page.readings.frames)

    def faded_out(self, actuators: int) -> bool:
        """Whether the first actuators are all silent."""
        return all(one.audible == 0.0 for one in self._page.actuators[:actuators])

    def readings(self) -> TransformReadings:
        """Return what the transform reports."""
        found = self._page.readings
        return TransformReadings(
            int(found.frames),
            int(found.replaced),
            int(found.limited),
            level_of(found.sound_peak, found.sound_square),
            level_of(found.vibration_peak, found.vibration_square),
        )

    def level(self, slot: int) -> Level:
        """Return the level of an actuator."""
        found = self._page.actuators[slot]
        return level_of(found.peak, found.square)

    def shown(self) -> Shown:
        """Return what a page shows; no partials where the plugin writes at every attempt."""
        first = 2 * self._channels
        partials = first + 2
        for _ in range(READ_TRIES):
            found = self._shown.unpack_from(self._memory, _SHOWN_AT)
            (again,) = _SEQUENCE.unpack_from(self._memory, _SEQUENCE_AT)
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
        return (self._channels, self._actuators, count), numbers

    def channel_readings(self) -> list[Reading]:
        """Return peak and mean square of each channel of the tap."""
        found = self._page.readings.channels[: self._channels]
        return [(peak, square) for peak, square in found]

    def principal(self) -> list[tuple[float, float, float]]:
        """Return what the latest hop vibrates, as `HapticTransform.principal` does."""
        (_, _, count), numbers = self.shown()
        found = numbers[len(numbers) - 3 * count :]
        return [*zip(found[::3], found[1::3], found[2::3], strict=True)]

    def close(self) -> None:
        """Remove the file; readings stay. May be repeated."""
        self.path.unlink(missing_ok=True)
