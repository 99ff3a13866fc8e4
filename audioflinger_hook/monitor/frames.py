"""Sends frames to browsers at a constant rate. A frame is a message with levels and frequencies.

The levels and frequencies come from a memory-mapped file of the engine, which saves CPU time of the
daemon. If the file lacks space for all channels or actuators, the daemon itself sends these values.
"""

import asyncio
import math
import mmap
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from audioflinger_hook.core.structures import CHANNELS
from audioflinger_hook.daemon.native.layout import ACTUATORS, ShownReader
from audioflinger_hook.monitor.figures import figures_of
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from device.errors import CushionError

REST_S = 0.15  # time without processed sound after which levels and frequencies are omitted


class Frames:
    """Forwards the daemon's messages and adds frames. Only the event loop's thread may use it.

    tell: called with (kind, content) of each message. rate_hz: frames per second. has_readers:
    returns whether a browser is connected.
    """

    def __init__(
        self,
        tell: Callable[[str, dict[str, Any]], None],
        rate_hz: float,
        has_readers: Callable[[], bool],
        environ: Mapping[str, str] = os.environ,
    ) -> None:
        self._tell, self._has_readers = tell, has_readers
        self._period_s, self._environ = 1.0 / rate_hz, environ
        self._frame: dict[str, Any] | None = None
        self._sent_s = -math.inf
        self._where: object = None
        self._memory: mmap.mmap | None = None
        self._reader: ShownReader | None = None
        self._frames, self._moved_s = 0, -math.inf
        self._old_sequence = -1

    def take(self, kind: str, content: dict[str, Any]) -> None:
        """Process a message from the daemon."""
        if kind == "link":
            self._frame = None
            self._follow(None)
        if kind != "frame":
            self._tell(kind, content)
            if kind == "status" and "version" in content:  # else content is an error text
                self._tell("figures", figures_of(content))
            return
        where = content.pop("memory", None)
        self._frame = {"sound": [], "vibration": [], "partials": []} | content
        self._follow(where)
        if self._reader is None:
            self._send(self._frame)

    async def run(self) -> None:
        """Send frames until the task is cancelled. Without new values, repeat the last frame."""
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            due_s = max(due_s + self._period_s, loop.time())
            await asyncio.sleep(due_s - loop.time())
            if self._frame is None or not self._has_readers():
                continue
            if self._reader is not None:
                self._send(self._frame | self._read(self._reader, loop.time()))
            elif loop.time() - self._sent_s > 1.5 * self._period_s:
                self._send(self._frame)

    def _send(self, frame: dict[str, Any]) -> None:
        self._sent_s = asyncio.get_running_loop().time()
        self._tell("frame", frame)

    def _read(self, reader: ShownReader, now_s: float) -> dict[str, Any]:
        """Return levels and frequencies, or an empty dict while no sound is processed."""
        frames = reader.frames
        if frames != self._frames:
            self._frames, self._moved_s = frames, now_s
        if now_s - self._moved_s > REST_S:
            self._old_sequence = reader.sequence
            return {}
        (channels, actuators, partials), exact = reader.shown()
        numbers = [float(f"{number:.5g}") for number in exact]
        of_vibration = 2 * channels
        of_partials = of_vibration + 2 * actuators
        if reader.sequence == self._old_sequence:  # the partials are from before the pause
            partials = 0
        return {
            "sound": _grouped(numbers[:of_vibration], 2),
            "vibration": _grouped(numbers[of_vibration:of_partials], 2),
            "partials": _grouped(numbers[of_partials : of_partials + 3 * partials], 3),
        }

    def _follow(self, where: Any) -> None:
        """Close the engine's file and open the one that `where` describes, if `where` is valid."""
        if where == self._where:
            return
        self._where = where
        self._reader = None
        if self._memory is not None:
            self._memory.close()
            self._memory = None
        with suppress(CushionError, OSError, ValueError, KeyError, TypeError):  # also for None
            name, channels, actuators = where["name"], where["channels"], where["actuators"]
            if not isinstance(channels, int) or not isinstance(actuators, int):
                return
            if "/" in name or not 1 <= channels <= CHANNELS or not 1 <= actuators <= ACTUATORS:
                return
            with RuntimeFolder(self._environ, create=False) as folder:
                flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
                file = os.fdopen(os.open(name, flags, dir_fd=folder.fd), "rb")
            with file:
                self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            reader = ShownReader(self._memory, channels, actuators)
            self._reader = reader if reader.is_known else None


def _grouped(numbers: list[float], size: int) -> list[list[float]]:
    return [numbers[at : at + size] for at in range(0, len(numbers), size)]
