"""Capture and playback streams on a server or a card, one block per callback of PortAudio.

Capture and playback are separate, as a duplex stream would poll. A callback never raises and
always delivers its full length, since an exception or a short block would end the stream silently.
A server that dies or suspends its device raises nothing: check `is_lost`, close the stream and open
another one.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from device.blocks import emptied, peak
from device.errors import UsageError
from device.stream.callback_thread import RELEASE_LIMIT_S, AudioPriority, GilState
from device.stream.pcms import Pcm, ServerDevice
from device.stream.portaudio import (
    BLOCK_FRAMES,
    OpenStream,
    StreamSetup,
    close_stream,
    open_stream,
)
from device.stream.sample_format import Encoder, SampleFormat
from device.units import Float32Array

LOST_AFTER_S = 0.5  # callbacks are at most 25 ms apart on an idle machine

BEGUN_AFTER_S, BEGINS_WITHIN_S = 0.05, 2.5
"""An idle sink of PulseAudio without norewinds has rendered up to 2 s ahead. A new playback stream
gets its first callbacks at once and the next after these 2 s; a capture stream waits for its
first."""

_CONTINUE = 0
_XRUNS = 0b1111  # PortAudio's flags for underflow and overflow of input and output

OnBlock = Callable[[Float32Array, float], None]
"""Takes (frames, channels) float32 and the time of the callback, time.monotonic()."""


class CallbackCounts:
    """Counts of a stream's callbacks. Any thread may read them; see `CaptureStream`."""

    def __init__(self, audible: bool) -> None:
        self.audible = audible
        self.opened_s = self.last_callback_s = time.monotonic()
        self.callbacks = self.frames = self.xruns = self.silenced = 0
        self.errors = Counter[str]()

    def _count(self, error: BaseException) -> None:
        self.errors[type(error).__name__] += 1


class _Stream(CallbackCounts):
    def __init__(
        self, pcm: Pcm, setup: StreamSetup, priority: AudioPriority | None, audible: bool
    ) -> None:
        samplerate, channels = setup.samplerate, setup.channels
        if not 1_000 <= samplerate <= 768_000:
            raise UsageError(
                f"samplerate={samplerate} Hz is out of range; choose 1000 to 768000 Hz"
            )
        if not 1 <= channels <= 32:
            raise UsageError(f"channels={channels} is out of range; choose 1 to 32")
        super().__init__(audible)
        self._priority, self._claimed = priority, -1
        self.samplerate, self.channels = samplerate, channels
        self._output = setup.output
        self._closing = False
        self._gil_state = GilState()
        self._close_lock = threading.Lock()
        self._on_server = isinstance(pcm.target, ServerDevice)
        self._open: OpenStream | None = None
        self._open = open_stream(pcm, setup, self._callback)
        self.tag = self._open.tag

    def is_lost(self, now_s: float | None = None) -> bool:
        """Whether no callback came for LOST_AFTER_S, or the stream was closed or ended.

        A new stream on a server has BEGINS_WITHIN_S. now_s: time.monotonic(). For any thread.
        """
        now_s = time.monotonic() if now_s is None else now_s
        young = self.last_callback_s - self.opened_s < BEGUN_AFTER_S
        begins = young and self._on_server and (self.callbacks > 0 or not self._output)
        limit_s = BEGINS_WITHIN_S if begins else LOST_AFTER_S
        return now_s - self.last_callback_s > limit_s or not self.is_active()

    def is_active(self) -> bool:
        """Whether PortAudio reports the stream as running, even if suspended."""
        opened = self._open
        try:
            return opened is not None and bool(opened.stream.is_active())
        except (OSError, ValueError, SystemError):  # closed by another thread
            return False

    def close(self) -> bool:
        """End the stream; return True if it ended in time, else it ends in the background.

        After True, no callback runs any more. Any thread but the callback's; may be repeated.
        """
        self._closing = True
        with self._close_lock:
            opened, self._open = self._open, None
        if opened is not None and time.monotonic() - self.last_callback_s < RELEASE_LIMIT_S:
            self._gil_state.wait_released()
        return opened is None or close_stream(opened)

    def _callback(
        self, data: bytes | None, frames: int, times: Any, flags: int
    ) -> tuple[bytes | None, int]:
        now_s = time.monotonic()
        try:
            if not self.callbacks:
                self._gil_state.keep()
            if self._priority is not None and self._claimed != self._priority.round:
                self._claimed = self._priority.round
                self._priority.claim()
            self.last_callback_s = now_s
            self.callbacks += 1
            self.frames += frames
            self.xruns += bool(flags & _XRUNS)
            if self._closing:
                self._gil_state.release()
            else:
                self._exchange(data, frames, now_s)
        except BaseException as error:  # PortAudio would end the stream
            self._count(error)
        return self._result(frames), _CONTINUE

    def _exchange(self, data: bytes | None, frames: int, now_s: float) -> None:
        raise NotImplementedError

    def _result(self, frames: int) -> bytes | None:
        return None


class CaptureStream(_Stream):
    """Delivers the frames of a PCM's source; runs from the moment it is made.

    pcm: its target is captured. samplerate: Hz. channels: per frame. on_frames: gets every block,
    read only, which it may keep, and the time. PortAudio's thread calls it: it must neither block
    nor close the stream. audible: any thread may set it; while False, the frames are 0 from the
    next block on. block_frames: per callback. priority: what the callback's thread requests.
    order: the source's channels in the order of delivery; None for their own.

    silenced: blocks that were. tag: value of the property `pcms.TAG`, by which the server shows
    the stream. opened_s, last_callback_s: the same before the first callback. xruns: overflows and
    underflows that PortAudio reported, which are few of them. errors: exceptions in callbacks,
    counted by name.

    LostError, NotFoundError: see `open_stream`; PipeWire may open a missing device and end the
    stream later. UsageError: samplerate or channels is out of range.
    """

    def __init__(
        self,
        pcm: Pcm,
        samplerate: int,
        channels: int,
        on_frames: OnBlock,
        *,
        audible: bool = True,
        block_frames: int = BLOCK_FRAMES,
        priority: AudioPriority | None = None,
        order: tuple[int, ...] | None = None,
    ) -> None:
        self._on_frames, self._order = on_frames, order
        setup = StreamSetup(False, samplerate, channels, block_frames, SampleFormat.FLOAT32)
        super().__init__(pcm, setup, priority, audible)

    def _exchange(self, data: bytes | None, frames: int, now_s: float) -> None:
        if not self.audible:
            self.silenced += 1
            data = bytes(len(data or b""))
        block = _as_frames(data or b"", self.channels)
        self._on_frames(block if self._order is None else block[:, self._order], now_s)


class PlaybackStream(_Stream):
    """Plays frames to a PCM's sink as it asks for them; silent until `audible` is set.

    PortAudio's thread calls both functions: they must neither block nor close the stream.

    fill: writes into every block, which is all 0, and must not keep it. If it raises, or leaves a
    sample that is not finite, the block becomes silence and counts in `errors`. on_sent: gets every
    block that was sent, silence included, read only, which it may keep. sample_format: of the bytes
    for PortAudio; `Encoder` clamps and rounds to integers.
    pcm, samplerate, channels, block_frames, priority: these, all attributes and errors are those of
    `CaptureStream`.
    """

    def __init__(
        self,
        pcm: Pcm,
        samplerate: int,
        channels: int,
        fill: OnBlock,
        on_sent: OnBlock | None = None,
        *,
        block_frames: int = BLOCK_FRAMES,
        priority: AudioPriority | None = None,
        sample_format: SampleFormat = SampleFormat.FLOAT32,
    ) -> None:
        self._fill, self._on_sent = fill, on_sent
        self._out = np.zeros((block_frames, channels), np.float32)
        self._used = False  # not all 0, because the last block failed
        is_float = sample_format is SampleFormat.FLOAT32
        self._encoder = None if is_float else Encoder(sample_format, channels, block_frames)
        self._bytes_per_frame = channels * sample_format.bytes_per_sample
        self._sound: bytes | None = None
        setup = StreamSetup(True, samplerate, channels, block_frames, sample_format)
        super().__init__(pcm, setup, priority, audible=False)

    def _exchange(self, data: bytes | None, frames: int, now_s: float) -> None:
        if self._used or len(self._out) != frames:
            self._out = np.zeros((frames, self.channels), np.float32)
        self._used = True
        self._fill(self._out, now_s)
        if self._encoder is None:
            self._sound = emptied(self._out)
        elif math.isfinite(peak(self._out)):
            self._sound = self._encoder.encode(self._out)
            self._out.fill(0.0)
        if self._sound is None:
            raise FloatingPointError("samples that are not finite")
        self._used = False

    def _result(self, frames: int) -> bytes | None:
        sound, self._sound = self._sound if self.audible else None, None
        if sound is None:
            self.silenced += 1
        if self._on_sent is not None:
            try:
                if sound is None:
                    sent = _as_frames(bytes(4 * frames * self.channels), self.channels)
                elif self._encoder is None:
                    sent = _as_frames(sound, self.channels)
                else:
                    sent = self._encoder.decode_last()
                self._on_sent(sent, self.last_callback_s)
            except BaseException as error:  # PortAudio would end the stream
                self._count(error)
        return bytes(frames * self._bytes_per_frame) if sound is None else sound


def _as_frames(data: bytes, channels: int) -> Float32Array:
    return np.frombuffer(data, np.float32).reshape(-1, channels)
