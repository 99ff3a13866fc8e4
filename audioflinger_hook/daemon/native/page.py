"""The page of memory that the daemon and the plugin share."""

from __future__ import annotations

import mmap
import os
from collections.abc import Sequence
from pathlib import Path

from audioflinger_hook.core import structures
from audioflinger_hook.core.structures import PARTIALS
from audioflinger_hook.daemon.native.layout import ACTUATORS, MAGIC, SIZE, Layout, ShownReader
from audioflinger_hook.service.meters import Level, Reading, level_of

DELAY_MAX_S = 2.0


class Page:
    """The shared page in a new file at `path`, which `close` removes.

    The supervising thread calls the methods; any thread may read levels and counts.

    sources: for each actuator, the number of its vibration. reader: of what a live page shows.
    """

    def __init__(self, path: Path, channels: int, vibrations: int, sources: Sequence[int]) -> None:
        self.path = path
        self._channels = channels
        self._vibrations = vibrations
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        file = os.open(path, flags, 0o600)
        try:
            os.ftruncate(file, SIZE)
            memory = mmap.mmap(file, SIZE)
        finally:
            os.close(file)
        self._page = page = Layout.from_buffer(memory)
        self.controls, self.readings = page.controls, page.readings
        self.reader = ShownReader(memory, channels, len(sources))
        page.controls.sound_gain = 1.0
        for controls, source in zip(page.controls.actuators, sources, strict=False):
            controls.gain, controls.source = 1.0, source
        page.size, page.magic = SIZE, MAGIC

    def show(
        self,
        frames: int,
        channels: Sequence[Reading],
        actuators: Sequence[Reading],
        partials: Sequence[tuple[float, float, float]],
    ) -> None:
        """Write what a live page shows, for an engine without a plugin.

        frames: processed so far. channels, actuators: their peaks and mean squares.
        """
        readings = self.readings
        for place, reading in zip(readings.sound, channels[: self._channels], strict=False):
            place.peak, place.mean_square = reading
        for place, reading in zip(readings.actuators, actuators[:ACTUATORS], strict=False):
            place.level.peak, place.level.mean_square = reading
        readings.sequence += 1  # odd: a reader tries again
        readings.partials_count = min(len(partials), PARTIALS)
        for slot, partial in enumerate(partials[:PARTIALS]):
            readings.partials[slot][:] = partial
        readings.sequence += 1
        readings.frames = frames

    def set_sound_gain(self, gain: float) -> None:
        """Set the factor on the tap's samples, 0 to 100; it changes over one buffer."""
        self.controls.sound_gain = gain

    def set_actuator(self, slot: int, gain: float, delay_frames: float) -> None:
        """Set an actuator's factor, -1 to 1, and its delay."""
        controls = self.controls.actuators[slot]
        controls.gain, controls.delay_frames = gain, max(0.0, delay_frames)

    def set_audible(self, audible: bool) -> None:
        """Fade all actuators in or out, within 40 ms."""
        for controls in self.controls.actuators:
            controls.audible = int(audible)

    @property
    def frames(self) -> int:
        """Frames that the transform has processed."""
        return int(self.readings.frames)

    @property
    def samplerate(self) -> int:
        """Hz of the host, 0 before there is a transform."""
        return int(self._page.samplerate)

    def faded_out(self, actuators: int) -> bool:
        """Whether the first actuators are all silent."""
        return all(one.audible == 0.0 for one in self.readings.actuators[:actuators])

    @property
    def cycle_frames(self) -> int:
        """Frames of the graph's latest cycle, 0 before the first."""
        return int(self._page.cycle_frames)

    @property
    def replaced_samples(self) -> int:
        """Unusable samples of the tap, which count as 0."""
        return int(self.readings.replaced)

    @property
    def limited_samples(self) -> int:
        """Samples of vibration that were limited at full scale."""
        return int(self.readings.limited)

    @property
    def levels(self) -> tuple[Level, Level]:
        """Levels of the sound and of the vibration."""
        found = self.readings
        sound, vibration = found.sound[: self._channels], found.vibration[: self._vibrations]
        return _loudest(sound), _loudest(vibration)

    def level(self, slot: int) -> Level:
        """Return the level of an actuator."""
        found = self.readings.actuators[slot].level
        return level_of(found.peak, found.mean_square)

    def channel_readings(self) -> list[Reading]:
        """Return peak and mean square of each channel of the tap."""
        found = self.readings.sound[: self._channels]
        return [(level.peak, level.mean_square) for level in found]

    def principal(self) -> list[tuple[float, float, float]]:
        """Return what the latest hop vibrates, as `HapticTransform.principal` does."""
        (_, _, count), numbers = self.reader.shown()
        found = numbers[len(numbers) - 3 * count :]
        return [*zip(found[::3], found[1::3], found[2::3], strict=True)]

    def close(self) -> None:
        """Remove the file; readings stay. May be repeated."""
        self.path.unlink(missing_ok=True)


def _loudest(levels: Sequence[structures.Level]) -> Level:
    """Return the largest peak of some channels, and the level of their mean power."""
    square = sum(level.mean_square for level in levels) / max(1, len(levels))
    return level_of(max((level.peak for level in levels), default=0.0), square)
