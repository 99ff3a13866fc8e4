"""Buffers of one tap on their way into the mix: mixed at once, or queued until the output asks."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.sources import PushTap, TapClient
from device.units import Float32Array

UNASKED_S = 0.05
"""An output that has not asked for so long does not play: the capture's thread mixes instead."""


class FrameReceiver(Protocol):
    """Who takes the buffers of a tap: `opened`, then `push`, again and again."""

    def opened(self, samplerate: int, channels: int) -> bool:
        """Be told of a new stream, Hz, before its first buffer; whether the format is another."""
        ...

    def moved(self) -> None:
        """Be told that the stream goes on from elsewhere in a moment. Any thread."""
        ...

    def push(self, frames: Float32Array, now_s: float) -> None:
        """Take (frames, channels) that came at now_s; on the thread that captures."""
        ...


class Feed:
    """One tap's buffers through an engine: each is recorded, if so, then mixed at once.

    recording: takes them as they are. The supervising thread makes the client, and calls `serve`
    before the first buffer; `opened` is called while nobody pushes.

    engine: what mixes, None before `serve`.
    """

    records_mix = False
    """Whether the mix is what was delivered; else the buffers are."""

    def __init__(self, recording: RunRecording | None = None) -> None:
        self.engine: Engine | None = None
        self._recording = recording
        self._tap: PushTap | None = None
        self._client: TapClient | None = None

    def client(self, samplerate: int, channels: int) -> TapClient:
        """Return what plays into the mix, which has this format."""
        self._tap = PushTap(samplerate, channels)
        self._client = TapClient(self._tap)
        if self._recording:
            self._recording.mix_is(samplerate, channels)
        return self._client

    def serve(self, engine: Engine) -> None:
        """Bring the buffers to this engine, which was made with `client`."""
        self.engine = engine

    def is_at(self, samplerate: int) -> bool:
        """Whether the buffers have this rate, Hz."""
        return self._tap is not None and self._tap.samplerate == samplerate

    def opened(self, samplerate: int, channels: int) -> bool:
        """See `FrameReceiver`."""
        return self.follow(samplerate, channels, discontinuity=True)

    def follow(self, samplerate: int, channels: int, *, discontinuity: bool) -> bool:
        """Be told what the next buffer is like, Hz; whether the format is another.

        discontinuity: whether frames are missing before it.
        """
        if self._tap is None:
            return False
        if discontinuity:
            self._tap.interrupt()
        return self._tap.change(samplerate, channels)

    def moved(self) -> None:
        """See `FrameReceiver`."""
        if self._tap is not None and self.engine is not None:
            self._tap.interrupt()
            self.engine.delay_line.expect_jump()

    def push(self, frames: Float32Array, now_s: float) -> None:
        """See `FrameReceiver`."""
        self.deliver(frames, now_s)

    def deliver(
        self, frames: Float32Array, now_s: float, earlier: Sequence[tuple[float, int]] = ()
    ) -> None:
        """Mix frames that came until now_s; earlier: see `Engine.advance`."""
        tap, client, engine = self._tap, self._client, self.engine
        if tap is None or client is None or engine is None or not len(frames):
            return
        broken = tap.push(frames)
        if self._recording:
            self._recording.delivered(frames, tap.samplerate, now_s, broken)
        while (tap.waiting or client.pending_frames) and engine.advance(now_s, earlier):
            pass

    def finish(self, now_s: float) -> Float32Array:
        """Let the sound end; return the vibration still owed. See `Engine.finish`."""
        assert self._tap is not None
        assert self.engine is not None
        self._tap.end()
        return self.engine.finish(now_s)


class CaptureQueue(Feed):
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
        """See `FrameReceiver`."""
        with self._mixing:
            self._arrived.clear()  # older than the gap, and perhaps of another format
            return super().opened(samplerate, channels)

    def moved(self) -> None:
        """See `FrameReceiver`."""
        with self._mixing:
            self._mix()
            super().moved()

    def push(self, frames: Float32Array, now_s: float) -> None:
        """See `FrameReceiver`."""
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
