"""Capture and playback streams on a sound server or a card; each callback exchanges one block.

Capture and playback are separate streams, because PortAudio would poll a full-duplex stream. An
exception or a short block in a callback would end its stream without notice. Therefore a callback
raises no exception and always returns a full block. The loss of a server raises no exception: check
`is_lost`, and open another stream.
"""

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
from device.stream.portaudio import BLOCK_FRAMES, OpenStream, StreamSetup, close_stream, open_stream
from device.stream.sample_format import Encoder, SampleFormat
from device.units import Float32Array

LOST_AFTER_S = 0.5  # a stream without a callback for this long is lost

BEGUN_AFTER_S, BEGINS_WITHIN_S = 0.05, 2.5
"""For new streams: on an idle sink without norewinds, PulseAudio renders up to 2 s ahead.
A playback stream then gets its first callbacks at once, and the next up to 2 s later. A capture
stream gets its first callback up to 2 s later."""

LONGEST_S = 10.0  # longest delay of an output that is believed
_CONTINUE = 0
_XRUNS = 0b1111  # PortAudio's flags for underflow and overflow of input and output

OnBlock = Callable[[Float32Array, float], None]  # (frames, channels), and time.monotonic()


class CallbackCounts:
    """A stream's counts, which `CaptureStream` describes. Any thread may read them."""

    def __init__(self, audible: bool) -> None:
        self.audible = audible
        self.opened_s = self.last_callback_s = time.monotonic()
        self.callbacks = self.frames = self.xruns = self.silenced = 0
        self.delay_s = 0.0
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

        For a new stream on a server, the limit is BEGINS_WITHIN_S, except before the first callback
        of playback. now_s: time.monotonic(). Any thread may call this.
        """
        now_s = time.monotonic() if now_s is None else now_s
        young = self.last_callback_s - self.opened_s < BEGUN_AFTER_S
        begins = young and self._on_server and (self.callbacks > 0 or not self._output)
        limit_s = BEGINS_WITHIN_S if begins else LOST_AFTER_S
        return now_s - self.last_callback_s > limit_s or not self.is_active()

    def is_active(self) -> bool:
        """Whether PortAudio reports the stream as running; a suspended stream counts as running."""
        opened = self._open
        try:
            return opened is not None and bool(opened.stream.is_active())
        except (OSError, ValueError, SystemError):  # another thread has closed the stream
            return False

    def close(self) -> bool:
        """Close the stream; return whether it closed in time. Else it closes in the background.

        If the first call returns True, no callback runs after it. Further calls have no effect. The
        callback must not call this.
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
            if self._output:  # after an underrun, PortAudio may report nonsense
                delay_s = times["output_buffer_dac_time"] - times["current_time"]
                self.delay_s = delay_s if 0.0 <= delay_s < LONGEST_S else self.delay_s
            self.callbacks += 1
            self.frames += frames
            self.xruns += bool(flags & _XRUNS)
            if self._closing:
                self._gil_state.release()
            else:
                self._exchange(data, frames, now_s)
        except BaseException as error:  # PortAudio would end the stream after an exception
            self._count(error)
        return self._result(frames), _CONTINUE

    def _exchange(self, data: bytes | None, frames: int, now_s: float) -> None:
        raise NotImplementedError

    def _result(self, frames: int) -> bytes | None:
        return None


class CaptureStream(_Stream):
    """Captures the target of a PCM in blocks; runs from its construction on.

    pcm: its target is captured. samplerate: Hz. channels: number of captured channels.
    block_frames: frames per callback. priority: gives the callback's thread its priority. order:
    number of the captured channel for each delivered channel; None keeps all in their order.
    on_frames: called by PortAudio's thread with every block, (frames, channels), read-only, and
    time.monotonic(). on_frames may keep the block, and must neither wait nor close the stream.
    audible: any thread may set it; while it is False, every sample is replaced by 0. silenced:
    number of blocks replaced by zeros. tag: value of the property `pcms.TAG` of the stream on
    the server. opened_s, last_callback_s: times by time.monotonic(), equal before any callback.
    xruns: number of callbacks with overflow or underflow; PortAudio does not report most of them.
    errors: number of exceptions in callbacks, by class name.
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
    """Plays blocks to the target of a PCM from its construction on; silent until `audible` is set.

    fill: called by PortAudio's thread with a block of zeros to write into, and time.monotonic().
    `fill` must not keep the block. If `fill` raises an exception or writes a sample that is not
    finite, silence is sent and `errors` increases. on_sent: called by the same thread with every
    sent block, even if silent, and time.monotonic(); it may read and keep the block. Neither
    function may wait or close the stream. sample_format: format of the samples for PortAudio.
    delay_s: time from the latest callback until its first frame is played, as the server reports.
    pcm, samplerate, channels, block_frames, priority, attributes, errors: as in `CaptureStream`.
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
        self._used = False  # whether the last block failed and may have left samples
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
                if sound is not None and self._encoder is not None:
                    sent = self._encoder.decode_last()
                else:
                    sent = _as_frames(sound or bytes(4 * frames * self.channels), self.channels)
                self._on_sent(sent, self.last_callback_s)
            except BaseException as error:  # PortAudio would end the stream after an exception
                self._count(error)
        return bytes(frames * self._bytes_per_frame) if sound is None else sound


def _as_frames(data: bytes, channels: int) -> Float32Array:
    return np.frombuffer(data, np.float32).reshape(-1, channels)
