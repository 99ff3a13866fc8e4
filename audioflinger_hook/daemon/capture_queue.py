"""Passes buffers of one tap to the engine: at once, or queued until the output asks."""

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

UNASKED_S = 0.05  # if the output has not called for this time, the capture's thread mixes
UNDONE_MAX_DB = 40.0  # below this volume, a sink of 16 bits has mostly noise left
PIPEWIRE_UNDONE_MAX_DB = 80.0  # the same on PipeWire, which mixes in floats: 5 %


class FrameReceiver(Protocol):
    """Takes the buffers of a tap: `opened`, then any number of `push`."""

    def opened(self, samplerate: int, channels: int) -> bool:
        """Prepare for a new stream (Hz, channels); return whether the format has changed."""

    def moved(self) -> None:
        """Prepare for the stream to move to another source. Any thread."""

    def push(self, frames: Float32Array, now_s: float) -> None:
        """Take (frames, channels) that arrived at `now_s`; on the capture's thread."""


def undone_db(volume_db: float, server: str) -> float:
    """Return how much of a volume, 0 dB for 100 %, is undone on "PulseAudio" or "PipeWire"."""
    limit_db = PIPEWIRE_UNDONE_MAX_DB if server == "PipeWire" else UNDONE_MAX_DB
    return max(-limit_db, volume_db)


class SoundGain:
    """A factor on the frames of a tap, which changes over one buffer.

    A factor above 1 brings no sample over full scale: a volume may rise before the server reports
    it. The capture's thread calls `apply`; any thread may set `wanted`.
    """

    def __init__(self) -> None:
        self.wanted = 1.0
        self._reached = 1.0

    def apply(self, frames: Float32Array) -> Float32Array:
        """Return the frames with the factor; the same array where it is 1."""
        wanted, before = self.wanted, self._reached
        if wanted == before == 1.0 or not len(frames):
            return frames
        self._reached = wanted
        factor: Float32Array | np.float32 = np.float32(wanted)
        if wanted != before:
            steps = np.arange(1, len(frames) + 1, dtype=np.float32) / np.float32(len(frames))
            factor = (np.float32(before) + np.float32(wanted - before) * steps)[:, None]
        with np.errstate(over="ignore", invalid="ignore"):  # of broken samples
            changed: Float32Array = frames * factor
        return np.clip(changed, -1.0, 1.0, out=changed) if max(wanted, before) > 1.0 else changed


class Feed:
    """Passes one tap's buffers to an engine at once, after a recording has taken them.

    The supervising thread calls `client` and `serve` before the first buffer, and `opened` while
    no thread pushes. gain: of the frames before all else, so that a recording has it as well.
    """

    records_mix = False  # a recording takes the buffers

    def __init__(self, recording: RunRecording | None = None) -> None:
        self.engine: Engine | None = None
        self.gain = SoundGain()
        self._recording = recording
        self._tap: PushTap | None = None
        self._client: TapClient | None = None

    def client(self, samplerate: int, channels: int) -> TapClient:
        """Return the client that plays into a mix of this format."""
        self._tap = PushTap(samplerate, channels)
        self._client = TapClient(self._tap)
        return self._client

    def serve(self, engine: Engine) -> None:
        """Pass the buffers to this engine, which was made with the client."""
        self.engine = engine

    def opened(self, samplerate: int, channels: int, *, discontinuity: bool = True) -> bool:
        """See `FrameReceiver`; discontinuity: whether frames are missing before the next buffer."""
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
        """Mix frames that arrived by `now_s`; earlier: see `Engine.advance`."""
        tap, client, engine = self._tap, self._client, self.engine
        if tap is None or client is None or engine is None or not len(frames):
            return
        frames = self.gain.apply(frames)
        broken = tap.push(frames)
        if self._recording:
            self._recording.delivered(frames, tap.samplerate, now_s, broken)
        while (tap.waiting or client.pending_frames) and engine.advance(now_s, earlier):
            pass

    def finish(self, now_s: float) -> Float32Array:
        """End the sound; return the last vibration, see `Engine.finish`."""
        assert self._tap is not None
        assert self.engine is not None
        self._tap.end()
        return self.engine.finish(now_s)


class CaptureQueue(Feed):
    """A `Feed` that queues buffers until the output's thread mixes them, before it reads.

    This saves CPU time, because one thread wakes up with warm caches instead of two. It adds no
    latency: the output reads several blocks at once, and new buffers are mixed before each read.

    The capture's thread calls `push`, the output's thread `pull`; a thread that finds the other one
    mixing continues at once. The supervising thread calls `opened` and `moved`.
    """

    def __init__(self, recording: RunRecording | None = None) -> None:
        super().__init__(recording)
        self._arrived: deque[tuple[Float32Array, float]] = deque()
        self._mixing = threading.Lock()

    def serve(self, engine: Engine) -> None:
        """See `Feed`."""
        super().serve(engine)
        engine.before_fill = self.pull

    def opened(self, samplerate: int, channels: int, *, discontinuity: bool = True) -> bool:
        """See `FrameReceiver`."""
        with self._mixing:
            self._arrived.clear()  # the queued buffers precede the gap and may have another format
            return super().opened(samplerate, channels, discontinuity=discontinuity)

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
        """Mix all queued buffers, unless the other thread is mixing."""
        if self._arrived and self.engine and self._mixing.acquire(blocking=False):
            try:
                self._mix()
            finally:
                self._mixing.release()

    def _mix(self) -> None:
        arrived, engine = self._arrived, self.engine
        while arrived and engine is not None:
            frames, now_s = arrived.popleft()
            earlier: list[tuple[float, int]] = []
            if arrived and self._tap is not None and self._tap.samplerate == engine.samplerate:
                parts, count = [frames], len(frames)
                while arrived and count + len(arrived[0][0]) <= engine.frames_max:
                    earlier.append((now_s, count))
                    frames, now_s = arrived.popleft()
                    parts.append(frames)
                    count += len(frames)
                frames = np.concatenate(parts) if earlier else frames
            self.deliver(frames, now_s, earlier)
