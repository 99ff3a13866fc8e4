"""Sound from and to the server, or to a card, a block at a time, on threads of PortAudio.

Two separate streams: one that captures and plays at once would poll. A callback never raises and
always delivers its full length, since an exception or a short block would end the stream without a
word; what goes wrong in it is counted by name. The clock is time.monotonic().

Whether a stream still runs shows in the age of its last callback: a server that dies or suspends
its device raises nothing. Ask `is_lost`, close the stream, open another one.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from device.errors import UsageError
from device.stream.gil_state import LET_GO_LIMIT_S, GilState
from device.stream.pcms import Pcm, ServerDevice
from device.stream.portaudio import BLOCK_FRAMES, OpenStream, close_stream, open_stream
from device.stream.priority import AudioPriority
from device.stream.sample_format import Encoder, SampleFormat
from device.units import Float32Array

LOST_AFTER_S = 0.5
"""Callbacks come 20 ms apart at worst on an idle machine, 25 ms with a thread that hogs Python."""

BEGUN_AFTER_S, BEGINS_WITHIN_S = 0.05, 2.5
"""A sink of PulseAudio without norewinds has played up to 2 s ahead while nobody played to it. What
begins there gets its first callbacks at once and the next when those 2 s are over; what captures,
the first."""

_CONTINUE = 0
_INPUT_UNDERFLOW, _INPUT_OVERFLOW, _OUTPUT_UNDERFLOW, _OUTPUT_OVERFLOW = 1, 2, 4, 8
_ERROR_NAMES = 16

OnFrames = Callable[[Float32Array, float], None]
Fill = Callable[[Float32Array, float], None]
OnSent = Callable[[Float32Array, float], None]


class _Stream:
    """What both streams have in common.

    Any thread may read, while the stream runs:

    tag: what the server shows of this stream (property `pcms.TAG`). opened_s: when it was opened.
    last_callback_s: start of the last callback, opened_s before the first. callbacks, frames: how
    many there were. xruns: overflows and underflows that PortAudio flagged; it flags few of them.
    errors: exceptions in callbacks, how many by name.

    audible: any thread may set it. While it is False there is silence instead of sound, from the
    very next block on. silenced: how many blocks that concerned.
    """

    def __init__(
        self,
        pcm: Pcm,
        samplerate: int,
        channels: int,
        *,
        output: bool,
        audible: bool,
        block_frames: int,
        priority: AudioPriority | None,
        sample_format: SampleFormat = SampleFormat.FLOAT32,
    ) -> None:
        self._priority = priority
        self.audible = audible
        self.silenced = 0
        self.pcm = pcm
        self.samplerate = samplerate
        self.channels = channels
        self.opened_s = self.last_callback_s = time.monotonic()
        self.callbacks = 0
        self.frames = 0
        self.xruns = 0
        self.errors: dict[str, int] = {}
        self._closing = False
        self._thread = GilState()
        self._close_lock = threading.Lock()
        self._on_server = isinstance(pcm.target, ServerDevice)
        self._output = output
        self._open: OpenStream | None = None
        self._open = open_stream(
            pcm,
            output=output,
            samplerate=samplerate,
            channels=channels,
            callback=self._callback,
            block_frames=block_frames,
            sample_format=sample_format,
        )
        self.tag = self._open.tag

    def is_lost(self, now_s: float | None = None) -> bool:
        """Whether no callback came for LOST_AFTER_S, or the stream ended. Any thread may call it.

        On a server a stream that has hardly begun has BEGINS_WITHIN_S. now_s: time.monotonic() if
        the caller has it at hand. A closed stream is lost.
        """
        now = time.monotonic() if now_s is None else now_s
        limit_s = BEGINS_WITHIN_S if self._begins else LOST_AFTER_S
        return now - self.last_callback_s > limit_s or not self.is_active()

    @property
    def _begins(self) -> bool:
        """Whether it is so young that the server's sink may be ahead of it."""
        young = self.last_callback_s - self.opened_s < BEGUN_AFTER_S
        return young and self._on_server and (self.callbacks > 0 or not self._output)

    def is_active(self) -> bool:
        """Whether PortAudio takes the stream for running, which it does of a suspended one too."""
        opened = self._open
        try:
            return opened is not None and bool(opened.stream.is_active())
        except (OSError, ValueError, SystemError):  # closed meanwhile
            return False

    def close(self) -> bool:
        """End the stream; whether it came back in time, else it ends by itself, later.

        Any thread but the callback's may call this, again too; it raises nothing. Once it returns
        True no callback runs any more.
        """
        self._closing = True
        with self._close_lock:
            opened, self._open = self._open, None
        if opened is not None and time.monotonic() - self.last_callback_s < LET_GO_LIMIT_S:
            self._thread.wait()
        return opened is None or close_stream(opened)

    def _callback(
        self, data: bytes | None, frames: int, times: Any, flags: int
    ) -> tuple[bytes | None, int]:
        now_s = time.monotonic()
        try:
            if not self.callbacks:
                self._thread.hold()
                if self._priority is not None:
                    self._priority.claim()
            self.last_callback_s = now_s
            self.callbacks += 1
            self.frames += frames
            if flags & (_INPUT_UNDERFLOW | _INPUT_OVERFLOW | _OUTPUT_UNDERFLOW | _OUTPUT_OVERFLOW):
                self.xruns += 1
            if self._closing:
                self._thread.let_go()
            else:
                self._exchange(data, frames, now_s)
        except BaseException as error:  # nothing may pass: PortAudio would end the stream
            self._count(error)
        return self._result(frames), _CONTINUE

    def _count(self, error: BaseException) -> None:
        name = type(error).__name__
        if name not in self.errors and len(self.errors) >= _ERROR_NAMES:
            name = "others"
        self.errors[name] = self.errors.get(name, 0) + 1

    def _exchange(self, data: bytes | None, frames: int, now_s: float) -> None:
        raise NotImplementedError

    def _result(self, frames: int) -> bytes | None:
        raise NotImplementedError


class CaptureStream(_Stream):
    """Frames of a PCM's source as they are delivered; runs from the moment it is made.

    on_frames(frames, now_s): called by a thread of PortAudio with float32 (frames, channels), read
    only, which may be kept, and the time of their arrival, in seconds of time.monotonic(). It must
    neither block nor close the stream; what it raises is counted in `errors`.

    audible: True from the start, unless given otherwise; while False the frames are all 0.
    block_frames: of a callback. priority: what its thread asks for, None for nothing.

    Raises
    ------
    LostError, NotFoundError
        See `open_stream`. PipeWire may let a device be opened that is not there and end the
        stream only then: look names up first (`identity`).
    UsageError
        samplerate (Hz) or channels cannot be had.
    """

    def __init__(
        self,
        pcm: Pcm,
        samplerate: int,
        channels: int,
        on_frames: OnFrames,
        *,
        audible: bool = True,
        block_frames: int = BLOCK_FRAMES,
        priority: AudioPriority | None = None,
    ) -> None:
        check_format(samplerate, channels)
        self._on_frames = on_frames
        super().__init__(
            pcm,
            samplerate,
            channels,
            output=False,
            audible=audible,
            block_frames=block_frames,
            priority=priority,
        )

    def _exchange(self, data: bytes | None, frames: int, now_s: float) -> None:
        if not self.audible:
            self.silenced += 1
            data = bytes(len(data or b""))
        buffer = np.frombuffer(data or b"", np.float32)
        self._on_frames(buffer.reshape(-1, self.channels), now_s)

    def _result(self, frames: int) -> bytes | None:
        return None


class PlaybackStream(_Stream):
    """Frames to a PCM's sink as it asks for them; silent until `audible` is set.

    fill(out, now_s): called by a thread of PortAudio to write float32 into out (frames, channels),
    which is all 0 and belongs to the caller again afterwards; now_s in seconds of
    time.monotonic(). It must neither block nor close the stream. If it raises, or leaves a sample
    that is not finite, the block becomes silence and is counted in `errors`.

    on_sent(frames, now_s): called likewise with what went to PortAudio for that block, silence too,
    as float32 whatever the format; the array is read only and may be kept.

    audible: False at first; while it is, fill is called and 0 is played. block_frames: of a
    callback. priority: what its thread asks for, None for nothing. sample_format: of what goes to
    PortAudio; integers are clamped and rounded as `Encoder` does.

    Raises
    ------
    LostError, NotFoundError, UsageError
        As `CaptureStream`.
    """

    def __init__(
        self,
        pcm: Pcm,
        samplerate: int,
        channels: int,
        fill: Fill,
        on_sent: OnSent | None = None,
        *,
        block_frames: int = BLOCK_FRAMES,
        priority: AudioPriority | None = None,
        sample_format: SampleFormat = SampleFormat.FLOAT32,
    ) -> None:
        check_format(samplerate, channels)
        self._fill = fill
        self._on_sent = on_sent
        self._out = np.zeros((block_frames, channels), np.float32)
        self._used = False  # whether it is not all 0: the last block came to nothing
        self._encoder = Encoder(sample_format, channels, block_frames)
        self._sound: bytes | None = None
        super().__init__(
            pcm,
            samplerate,
            channels,
            output=True,
            audible=False,
            block_frames=block_frames,
            priority=priority,
            sample_format=sample_format,
        )

    def _exchange(self, data: bytes | None, frames: int, now_s: float) -> None:
        if self._used or len(self._out) != frames:
            self._out = np.zeros((frames, self.channels), np.float32)
        self._used = True
        self._fill(self._out, now_s)
        self._sound = self._encoder.take(self._out)
        if self._sound is None:
            raise FloatingPointError("samples that are not finite")
        self._used = False

    def _result(self, frames: int) -> bytes | None:
        sound, self._sound = self._sound, None
        if not self.audible:
            sound = None
        if sound is None:
            self.silenced += 1
        if self._on_sent is not None:
            try:
                sent = self._silence(frames) if sound is None else self._encoder.encoded()
                self._on_sent(sent, self.last_callback_s)
            except BaseException as error:  # nothing may pass, as above
                self._count(error)
        return self._encoder.silence(frames) if sound is None else sound

    def _silence(self, frames: int) -> Float32Array:
        silence = np.zeros((frames, self.channels), np.float32)
        silence.setflags(write=False)
        return silence


def check_format(samplerate: int, channels: int) -> None:
    """Refuse what no stream can have: UsageError. Any thread may call it."""
    if not 1_000 <= samplerate <= 768_000:
        raise UsageError(f"samplerate={samplerate} Hz is not possible; 1000 to 768000 Hz are")
    if not 1 <= channels <= 32:
        raise UsageError(f"channels={channels} is not possible; 1 to 32 are")
