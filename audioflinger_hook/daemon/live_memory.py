"""What a page shows many times a second: frames as lines of JSON, and the Python engine's memory.

Each frame is computed after a pause in which other programs used the processor's caches. So it
costs what it touches: numbers are read at once and put into one form at once. A client of this
computer reads them in memory: the plugin of the native engine and the Python engine's audio thread
write them to the same layout, and no thread of the daemon wakes for a page.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING

from audioflinger_hook.core.structures import CHANNELS
from audioflinger_hook.daemon.native.layout import ACTUATORS, Shown
from audioflinger_hook.daemon.native.page import Page
from audioflinger_hook.service.meters import LevelMeter
from audioflinger_hook.service.state import DaemonState

if TYPE_CHECKING:
    from audioflinger_hook.daemon.engine import Engine
    from audioflinger_hook.daemon.supervisor import Supervisor

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
        self._writes_left = self._due_frames = 0

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


_IN_MEMORY = (
    b'{"frame": {"state": "%s", "level": %.4g, '
    b'"memory": {"name": "%s", "channels": %d, "actuators": %d}, "missed": %d}}\n'
)


def frame_of(
    supervisor: Supervisor, level: float, missed: int, *, in_memory: bool
) -> tuple[bytes, bool]:
    """Return `{"frame": ...}` with a line break, and whether the next one may come later.

    Any thread may call it; audio threads do not wait for it. The frame has the numbers of `Shown`,
    or for a client that reads them in memory the file of the engine that plays.

    level: factor on the vibration, 0 while it is muted. missed: frames that were not sent.
    """
    state = supervisor.states.state
    plays = state is DaemonState.RUNNING
    native, engine = supervisor.engines.native.engine, supervisor.engines.python
    chain = native.chain if native is not None and native.audible else None
    page = chain.page if chain is not None else None
    if page is None and in_memory and engine is not None and engine.live is not None:
        engine.live.watch()
        page = engine.live.page
    shown: Shown = ((0, 0, 0), ())
    if page is not None and in_memory:
        name, reader = page.path.name.encode(), page.reader
        counts = reader.channels, reader.actuators
        return _IN_MEMORY % (state.value.encode(), level, name, *counts, missed), True
    if page is not None and plays:
        shown = page.reader.shown()
    elif engine is not None and plays:
        shown = _shown_of(engine)
    return _form(*shown[0]) % (state.value.encode(), level, *shown[1], missed), not plays


@cache
def _form(channels: int, actuators: int, partials: int) -> bytes:
    """Return the form of a frame; an engine shows a few dozen different ones."""
    pairs, triples = "[%.4g, %.4g]", "[%.5g, %.5g, %.4g]"
    return (
        '{"frame": {"state": "%s", "level": %.4g, '
        f'"sound": [{", ".join([pairs] * channels)}], '
        f'"vibration": [{", ".join([pairs] * actuators)}], '
        f'"partials": [{", ".join([triples] * partials)}], '
        '"missed": %d}}\n'
    ).encode()


def _shown_of(engine: Engine) -> Shown:
    channels = engine.sound.meter.channel_readings()
    actuators = [meter.reading() for meter in engine.driven_meters]
    partials = engine.framework.principal
    counts = len(channels), len(actuators), len(partials)
    return counts, (*chain(*channels), *chain(*actuators), *chain(*partials))
