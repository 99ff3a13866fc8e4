"""Buffers of one tap that wait until the output needs them: what came by then is one cycle."""

from __future__ import annotations

import threading
from collections import deque

import numpy as np

from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.feed import Feed
from audioflinger_hook.daemon.recording import RunRecording
from device.units import Float32Array

UNASKED_S = 0.05
"""An output that has not asked for so long does not play: the capture's thread mixes instead."""


class PulledFeed(Feed):
    """A `Feed` that mixes on the output's thread, just before the delay line is read.

    No frame is felt any later: the output reads all that the delay line has, which lasts for some
    blocks, and what came by the next read is mixed just before it, by a thread that had to wake
    up anyway. (A thread that wakes up finds its caches cold, and what it does then takes several
    times as long; see docs/decisions.md.)

    `push` is called by the capture's thread, `pull` by the output's; one of the two mixes, the
    other one goes on meanwhile. `opened` and `moved` are the supervising thread's.
    """

    def __init__(self, recording: RunRecording | None = None) -> None:
        super().__init__(recording)
        self._arrived: deque[tuple[Float32Array, float]] = deque()
        self._mixing = threading.Lock()

    def serve(self, engine: Engine) -> None:
        """See `Feed`."""
        super().serve(engine)
        engine.before_fill = self.pull

    def opened(self, samplerate: int, channels: int) -> bool:
        """See `Taker`."""
        with self._mixing:
            self._arrived.clear()  # older than the gap, and perhaps of another format
            return super().opened(samplerate, channels)

    def moved(self) -> None:
        """See `Taker`."""
        with self._mixing:
            self._mix()
            super().moved()

    def push(self, frames: Float32Array, now_s: float) -> None:
        """See `Taker`."""
        engine = self.engine
        if engine is None or not len(frames):
            return
        self._arrived.append((frames, now_s))
        if now_s - engine.filled_s > UNASKED_S:
            self.pull()

    def pull(self) -> None:
        """Mix all that came so far, unless the other thread is doing that."""
        engine = self.engine
        if not self._arrived or engine is None:
            return
        if not self._mixing.acquire(blocking=False):
            return
        try:
            self._mix()
        finally:
            self._mixing.release()

    def _mix(self) -> None:
        arrived, engine = self._arrived, self.engine
        while arrived and engine is not None:
            frames, now_s = arrived.popleft()
            earlier: list[tuple[float, int]] = []
            if arrived and self.is_at(engine.samplerate):
                parts, count = [frames], len(frames)
                while arrived and count + len(arrived[0][0]) <= engine.frames_max:
                    earlier.append((now_s, count))
                    frames, now_s = arrived.popleft()
                    parts.append(frames)
                    count += len(frames)
                frames = np.concatenate(parts) if earlier else frames
            self.deliver(frames, now_s, earlier)
