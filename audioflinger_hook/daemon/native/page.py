"""The page of memory that the daemon and the plugin share."""

from __future__ import annotations

import mmap
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from audioflinger_hook.daemon.native.layout import (
    ACTUATORS,
    MAGIC,
    PARTIALS,
    SIZE,
    Layout,
    ShownReader,
)
from audioflinger_hook.service.meters import Level, Reading, level_of
from audioflinger_hook.transform.downmix import mix_weights
from device.drive.damping import Damping
from device.units import FloatArray

DELAY_MAX_S = 2.0


@dataclass(frozen=True)
class TransformReadings:
    """What the transform reports: frames so far, counts of samples, the graph's cycle, levels.

    samplerate: of the host in Hz; 0 before there is a transform. cycle_frames: of the latest cycle.
    """

    frames: int
    replaced_samples: int
    limited_samples: int
    samplerate: int
    cycle_frames: int
    sound: Level
    vibration: Level


class Page:
    """The shared page in a separate file, which `close` removes.

    The supervising thread calls the methods; any thread may call `readings` and `level`.

    path: of the file; it must not exist. channels: of the tap. outputs: vibrations. actuators: that
    play them. weights: (channels, outputs, 2) of the sources' halves; None for the mono mix, or for
    each channel separately. reader: of what a live page shows.
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
        self._channels = channels
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        file = os.open(path, flags, 0o600)
        try:
            os.ftruncate(file, SIZE)
            memory = mmap.mmap(file, SIZE)
        finally:
            os.close(file)
        self._page = page = Layout.from_buffer(memory)
        self.reader = ShownReader(memory, channels, actuators)
        page.transform.channels, page.transform.outputs = channels, outputs
        page.transform.mixed = weights is not None
        if weights is not None:
            for output in range(outputs):
                for row, numbers in enumerate(mix_weights(weights[:, output])):
                    page.transform.weights[output][row][:channels] = numbers.tolist()
        page.sound_gain = 1.0
        for wishes in page.wishes:
            wishes.gain = 1.0
        page.size, page.magic = SIZE, MAGIC

    def show(
        self,
        frames: int,
        channels: Sequence[Reading],
        actuators: Sequence[Reading],
        partials: Sequence[tuple[float, float, float]],
    ) -> None:
        """Write what a live page shows, as the plugin does; for an engine without a plugin.

        frames: processed so far. channels, actuators: their peaks and mean squares. partials: at
        most PARTIALS of them count.
        """
        page = self._page
        for slot, reading in enumerate(channels[: self._channels]):
            page.readings.channels[slot][:] = reading
        for slot, (peak, square) in enumerate(actuators[:ACTUATORS]):
            page.actuators[slot].peak, page.actuators[slot].square = peak, square
        shown = page.partials
        shown.sequence += 1  # odd: a reader tries again
        shown.count = min(len(partials), PARTIALS)
        for slot, partial in enumerate(partials[:PARTIALS]):
            shown.partials[slot][:] = partial
        shown.sequence += 1
        page.readings.frames = frames

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

    @property
    def samplerate(self) -> int:
        """Hz of the host, 0 before there is a transform."""
        return int(self._page.readings.samplerate)

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
            int(found.samplerate),
            int(found.cycle_frames),
            level_of(found.sound_peak, found.sound_square),
            level_of(found.vibration_peak, found.vibration_square),
        )

    def level(self, slot: int) -> Level:
        """Return the level of an actuator."""
        found = self._page.actuators[slot]
        return level_of(found.peak, found.square)

    def channel_readings(self) -> list[Reading]:
        """Return peak and mean square of each channel of the tap."""
        found = self._page.readings.channels[: self._channels]
        return [(peak, square) for peak, square in found]

    def principal(self) -> list[tuple[float, float, float]]:
        """Return what the latest hop vibrates, as `HapticTransform.principal` does."""
        (_, _, count), numbers = self.reader.shown()
        found = numbers[len(numbers) - 3 * count :]
        return [*zip(found[::3], found[1::3], found[2::3], strict=True)]

    def close(self) -> None:
        """Remove the file; readings stay. May be repeated."""
        self.path.unlink(missing_ok=True)
