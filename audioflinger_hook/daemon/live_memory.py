"""The Python engine's levels and partials, in a file that a live page reads.

The plugin of the native engine writes the same layout. No thread of the daemon wakes for a page:
the audio thread writes while its caches are warm.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path

from audioflinger_hook.core.structures import CHANNELS
from audioflinger_hook.daemon.native.layout import ACTUATORS
from audioflinger_hook.daemon.native.page import Page
from audioflinger_hook.service.meters import LevelMeter

NAME = "python"
_numbers = count()  # A reader must notice that a later engine has a file of its own.

WRITES_PER_S = 60.0
WRITES_LEFT = 60  # after the latest `watch`: for a second, in which clients ask four times


class LiveMemory:
    """A file that a live page reads, written only while somebody watches.

    folder: private; files of earlier engines are removed. OSError: the file cannot be made.
    """

    def __init__(self, folder: Path, samplerate: int, channels: int, actuators: int) -> None:
        for left_over in folder.glob(f"{NAME}-*.page"):  # of a daemon that was killed
            left_over.unlink(missing_ok=True)
        path = folder / f"{NAME}-{next(_numbers)}.page"
        self.page = Page(path, channels, 1, [0] * actuators)
        self._least_frames = round(samplerate / WRITES_PER_S)
        self._writes_left = 0
        self._due_frames = 0

    def watch(self) -> None:
        """Note that somebody watches; any thread may call it."""
        self._writes_left = WRITES_LEFT

    def is_due(self, frames: int) -> bool:
        """Whether to call `show` now; frames: processed so far. For the audio thread."""
        return self._writes_left > 0 and frames >= self._due_frames

    def show(
        self,
        frames: int,
        sound: LevelMeter,
        actuators: Sequence[LevelMeter],
        partials: Sequence[tuple[float, float, float]],
    ) -> None:
        """Write what a page shows; frames: processed so far. For the audio thread."""
        self._writes_left -= 1
        self._due_frames = frames + self._least_frames
        levels = [meter.reading() for meter in actuators]
        self.page.show(frames, sound.channel_readings(), levels, partials)

    def close(self) -> None:
        """Remove the file. May be repeated."""
        with suppress(OSError):
            self.page.close()


def live_memory(
    folder: Path | None, samplerate: int, channels: int, actuators: int
) -> LiveMemory | None:
    """Return the file that a page reads; None where it cannot be made or holds too little."""
    if folder is None or channels > CHANNELS or actuators > ACTUATORS:
        return None
    with suppress(OSError):
        return LiveMemory(folder, samplerate, channels, actuators)
    return None
