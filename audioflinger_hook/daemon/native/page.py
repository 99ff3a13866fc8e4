"""Memory that the daemon shares with the plugin and the live page."""

import ctypes
import mmap
import os
from collections.abc import Sequence
from pathlib import Path

from audioflinger_hook.core import structures
from audioflinger_hook.core.structures import PARTIALS, Controls, Readings
from audioflinger_hook.daemon.native import layout
from audioflinger_hook.service.meters import Level, Reading, level_of

DELAY_MAX_S = 2.0


class Page:
    """Shared memory in a new file at `path`, which `close` removes.

    Any thread may read levels and counts. channels, vibrations: numbers of sound channels and of
    vibration signals. sources: index of the vibration signal that each actuator plays.
    reader: reads values for the live page. layout: all values; of the numbers of designs in it, the
    plugin reads `wanted` and writes `playing`, and `refused` if it cannot use a changed design.
    """

    def __init__(self, path: Path, channels: int, vibrations: int, sources: Sequence[int]) -> None:
        self.path, self._channels = path, channels
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        with os.fdopen(os.open(path, flags, 0o600), "r+b") as file:
            file.truncate(layout.SIZE)
            memory = mmap.mmap(file.fileno(), layout.SIZE)
        self.layout = page = layout.Layout.from_buffer(memory)
        self.reader = layout.ShownReader(memory, channels, len(sources))
        self.prepare(0, vibrations, sources)
        page.size, page.magic = layout.SIZE, layout.MAGIC

    def prepare(self, number: int, vibrations: int, sources: Sequence[int]) -> layout.Bank:
        """Return the bank of the design `number`, with new readings and unit gains.

        The design that plays must not use this bank.
        """
        before, bank = self._playing.controls, self.layout.banks[number % layout.BANKS]
        ctypes.memset(ctypes.byref(bank), 0, ctypes.sizeof(bank))
        bank.controls.sound_gain = before.sound_gain if number else 1.0
        for slot, source in enumerate(sources[: layout.ACTUATORS]):
            controls = bank.controls.actuators[slot]
            controls.gain, controls.source = 1.0, source
            controls.audible = before.actuators[slot].audible
        self._vibrations = vibrations
        return bank  # type: ignore[no-any-return]

    @property
    def controls(self) -> Controls:
        """Controls of the design that plays."""
        return self._playing.controls  # type: ignore[no-any-return]

    @property
    def readings(self) -> Readings:
        """Readings of the design that plays."""
        return self._playing.readings  # type: ignore[no-any-return]

    @property
    def _playing(self) -> layout.Bank:
        return self.layout.banks[self.layout.playing % layout.BANKS]  # type: ignore[no-any-return]

    def show(
        self,
        frames: int,
        channels: Sequence[Reading],
        actuators: Sequence[Reading],
        partials: Sequence[tuple[float, float, float]],
    ) -> None:
        """Write readings for the live page. channels, actuators: peak and mean square of each."""
        readings = self.readings
        for place, reading in zip(readings.sound, channels[: self._channels], strict=False):
            place.peak, place.mean_square = reading
        for place, reading in zip(readings.actuators, actuators[: layout.ACTUATORS], strict=False):
            place.level.peak, place.level.mean_square = reading
        readings.sequence += 1  # an odd number makes readers try again
        readings.partials_count = min(len(partials), PARTIALS)
        for slot, partial in enumerate(partials[:PARTIALS]):
            readings.partials[slot][:] = partial
        readings.sequence += 1
        readings.frames = frames

    def set_sound_gain(self, gain: float) -> None:
        """Set the gain of the tap's samples, 0 or more. The change extends over one buffer."""
        for bank in self.layout.banks:
            bank.controls.sound_gain = gain

    def set_actuator(
        self, slot: int, gain: float, delay_frames: float, *, holds: bool = False
    ) -> None:
        """Set the gain, -1 to 1, and the delay in frames of the actuator with index `slot`.

        holds: the design that plays keeps its gain if the new gain is larger.
        """
        for number, bank in enumerate(self.layout.banks):
            controls = bank.controls.actuators[slot]
            holds_this = holds and number == self.layout.playing % layout.BANKS
            if not holds_this or abs(gain) <= abs(controls.gain):
                controls.gain = gain
            controls.delay_frames = max(0.0, delay_frames)

    @property
    def delay_frames(self) -> float:
        """The longest delay of an actuator in frames."""
        return max(float(one.delay_frames) for one in self.controls.actuators)

    def set_audible(self, audible: bool) -> None:
        """Fade the vibration of all actuators in or out within 40 ms."""
        for bank in self.layout.banks:
            for controls in bank.controls.actuators:
                controls.audible = int(audible)

    @property
    def frames(self) -> int:
        """Number of frames that the transform has processed."""
        return int(self.readings.frames)

    @property
    def samplerate(self) -> int:
        """Sample rate of the plugin in Hz, 0 before the plugin runs."""
        return int(self.layout.samplerate)

    def faded_out(self, actuators: int) -> bool:
        """Whether the first `actuators` actuators are silent."""
        return all(one.audible == 0.0 for one in self.readings.actuators[:actuators])

    @property
    def cycle_frames(self) -> int:
        """Length of the graph's latest cycle in frames, 0 before the first cycle."""
        return int(self.layout.cycle_frames)

    @property
    def levels(self) -> tuple[Level, Level]:
        """Levels of the sound and of the vibration."""
        found = self.readings
        sound, vibration = found.sound[: self._channels], found.vibration[: self._vibrations]
        return _loudest(sound), _loudest(vibration)

    def level(self, slot: int) -> Level:
        """Return the level of the actuator with index `slot`."""
        found = self.readings.actuators[slot].level
        return level_of(found.peak, found.mean_square)

    def channel_readings(self) -> list[Reading]:
        """Return peak and mean square of each channel of the tap."""
        return [(one.peak, one.mean_square) for one in self.readings.sound[: self._channels]]

    def principal(self) -> list[tuple[float, float, float]]:
        """Return the latest partials. See `HapticTransform.principal`."""
        (_, _, count), numbers = self.reader.shown()
        found = numbers[len(numbers) - 3 * count :]
        return [*zip(found[::3], found[1::3], found[2::3], strict=True)]

    def close(self) -> None:
        """Remove the file; the values remain readable. Repeated calls do nothing."""
        self.path.unlink(missing_ok=True)


def _loudest(levels: Sequence[structures.Level]) -> Level:
    square = sum(level.mean_square for level in levels) / max(1, len(levels))
    return level_of(max((level.peak for level in levels), default=0.0), square)
