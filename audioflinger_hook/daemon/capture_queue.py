"""Passes buffers of one tap to the Python engine, immediately or when the output thread asks."""

import threading
from collections import deque
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.sources import PushTap, TapClient
from device.units import Float32Array

UNASKED_S = 0.05  # after this time without a call of `Engine.fill`, the capture thread mixes


class FrameReceiver(Protocol):
    """Receives a tap's buffers. `opened` is called before the first `push` of each new stream."""

    def opened(self, samplerate: int, channels: int) -> bool:
        """Prepare for a new stream; return whether the format has changed. samplerate: Hz."""

    def moved(self) -> None:
        """Prepare for a move of the stream to another source. `push` may run at the same time."""

    def push(self, frames: Float32Array, now_s: float) -> None:
        """Process samples (frames, channels) that came at `now_s`. The capture thread calls it."""


def undone_db(volume_db: float, server: str) -> float:
    """Return `volume_db` (0 dB is 100 %), but at least -80 dB on PipeWire and -40 dB elsewhere."""
    return max(-80.0 if server == "PipeWire" else -40.0, volume_db)


class SoundGain:
    """Multiplies samples by the gain `wanted`. A change of the gain extends over one buffer.

    At a gain above 1, samples are limited to full scale, because the gain may still compensate an
    earlier, lower volume. Only one thread may call `apply` at a time. Any thread may set `wanted`.
    """

    def __init__(self) -> None:
        self.wanted = self._reached = 1.0

    def apply(self, frames: Float32Array) -> Float32Array:
        """Return the samples times the gain. For a constant gain of 1, return `frames` itself."""
        wanted, before = self.wanted, self._reached
        if wanted == before == 1.0 or not len(frames):
            return frames
        self._reached = wanted
        factor: Float32Array | np.float32 = np.float32(wanted)
        if wanted != before:
            steps = np.arange(1, len(frames) + 1, dtype=np.float32) / np.float32(len(frames))
            factor = (np.float32(before) + np.float32(wanted - before) * steps)[:, None]
        with np.errstate(over="ignore", invalid="ignore"):  # samples may be NaN or infinite
            changed: Float32Array = frames * factor
        return np.clip(changed, -1.0, 1.0, out=changed) if max(wanted, before) > 1.0 else changed


class Feed:
    """Passes buffers of one tap to a recording and then to an engine.

    `opened` and `push` must not run at the same time. gain: applied before recording and mixing.
    """

    records_mix = False  # a recording stores the tap's buffers, not the mix

    def __init__(self, recording: RunRecording | None = None) -> None:
        self.engine: Engine | None = None
        self.gain = SoundGain()
        self._recording = recording
        self._tap: PushTap | None = None
        self._client: TapClient | None = None

    def client(self, samplerate: int, channels: int) -> TapClient:
        """Return the mixer's source of buffers. samplerate (Hz), channels: of the mix."""
        self._tap = PushTap(samplerate, channels)
        self._client = TapClient(self._tap)
        return self._client

    def serve(self, engine: Engine) -> None:
        """Pass later buffers to this engine, whose client must be the result of `client`."""
        self.engine = engine

    def opened(self, samplerate: int, channels: int, *, discontinuity: bool = True) -> bool:
        """See `FrameReceiver`. discontinuity: whether frames are missing before the next buffer."""
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
        """Record and mix frames. now_s, earlier: arrival times; see `DelayLine.write`."""
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
        """Mix the rest of the sound; return its vibration. See `Engine.finish`."""
        assert self._tap is not None
        assert self.engine is not None
        self._tap.end()
        return self.engine.finish(now_s)


class CaptureQueue(Feed):
    """A `Feed` that saves CPU time: the output thread mixes several buffers in one call.

    The output thread calls `pull` before each read of the delay line. The capture thread calls
    `push`, which mixes only if `Engine.fill` has not run for UNASKED_S seconds. Neither thread
    waits for the other. The supervising thread calls `opened` and `moved`.
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
            self._arrived.clear()  # queued buffers may have the old format
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
        """Mix the buffers that `push` has stored, unless another thread is mixing."""
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
