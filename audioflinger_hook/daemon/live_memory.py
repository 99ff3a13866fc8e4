"""Shared memory of the Python engine for the live page, laid out as the native engine's."""

from collections.abc import Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path

from audioflinger_hook.core.structures import CHANNELS
from audioflinger_hook.daemon.native.layout import ACTUATORS
from audioflinger_hook.daemon.native.page import Page
from audioflinger_hook.service.meters import LevelMeter

NAME = "python"
_numbers = count()  # part of the file name; a new name tells readers that the engine is new

WRITES_PER_S = 60.0  # largest rate of writes
WRITES_LEFT = 60  # number of writes after a call of `watch`; they take at least one second


class LiveMemory:
    """A file in a private folder for the live page, written only after calls of `watch`.

    samplerate: Hz. channels, actuators: numbers of sound levels and of vibration levels.
    """

    def __init__(self, folder: Path, samplerate: int, channels: int, actuators: int) -> None:
        for left_over in folder.glob(f"{NAME}-*.page"):  # left by a killed daemon
            left_over.unlink(missing_ok=True)
        self.page = Page(folder / f"{NAME}-{next(_numbers)}.page", channels, 1, [0] * actuators)
        self._least_frames = round(samplerate / WRITES_PER_S)
        self._writes_left = self._due_frames = 0

    def watch(self) -> None:
        """Permit WRITES_LEFT calls of `show`. Any thread may call it."""
        self._writes_left = WRITES_LEFT

    def is_due(self, frames: int) -> bool:
        """Whether to call `show` after `frames` processed frames. The audio thread calls it."""
        return self._writes_left > 0 and frames >= self._due_frames

    def show(
        self,
        frames: int,
        sound: LevelMeter,
        actuators: Sequence[LevelMeter],
        partials: Sequence[tuple[float, float, float]],
    ) -> None:
        """Write levels and partials after `frames` processed frames. The audio thread calls it."""
        self._writes_left -= 1
        self._due_frames = frames + self._least_frames
        levels = [meter.reading() for meter in actuators]
        self.page.show(frames, sound.channel_readings(), levels, partials)

    def close(self) -> None:
        """Remove the file. Repeated calls do nothing."""
        with suppress(OSError):
            self.page.close()


def live_memory(
    folder: Path | None, samplerate: int, channels: int, actuators: int
) -> LiveMemory | None:
    """Return the file for the live page; None without `folder` or if it cannot be created.

    None is also returned for more channels or actuators than the layout can hold.
    """
    if folder is None or channels > CHANNELS or actuators > ACTUATORS:
        return None
    with suppress(OSError):
        return LiveMemory(folder, samplerate, channels, actuators)
    return None
