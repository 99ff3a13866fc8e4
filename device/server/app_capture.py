"""One application's sound, captured before the mix: the stream that it plays, and nothing else.

A server gives a record stream the sound of one stream that plays (its sink input) if it is asked
for that when the record stream is made; PortAudio and ALSA cannot ask. On PulseAudio 16.1 and
PipeWire 0.3.65 alike the sound comes after the application's own volume and mute, as it takes part
in the mix, and before the sink's. At 100 % and equal rates samples come bit for bit.

It cannot lead anywhere else: it may not be moved, and a server ends it once the application's
stream is gone. PulseAudio also ends it when that stream moves to another sink; PipeWire goes on.
While the application pauses, PulseAudio delivers silence and PipeWire nothing.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from ctypes import byref, string_at
from enum import StrEnum
from typing import Any

import numpy as np

from device.server import libpulse
from device.stream.streams import OnFrames

_ERROR_NAMES = 16


class EndReason(StrEnum):
    """Why a capture has ended."""

    GONE = "the application's stream has ended"
    TAKEN = "the server ended the capture, as it does when the application's stream moves"
    LOST = "the sound server was lost"
    CLOSED = "the capture was closed"


class AppCapture:
    """Frames of one application's stream as they are delivered. Made by `AppCaptures.open`.

    Any thread may read:

    stream_index: of the sink input. tag: what the server shows of this capture (property
    `pcms.TAG`). samplerate: Hz; channels. opened_s: when it was opened. last_callback_s: when
    frames came last, opened_s before the first. callbacks, frames: how many there were; callbacks
    differ in length. xruns: how often the server told that frames are missing; there is silence in
    their place. errors: exceptions in on_frames, how many by name.
    ended: None while it runs, else why it does not (an `Ended`, whose text says it).

    audible: any thread may set it. While it is False the frames are all 0. silenced: how many
    callbacks that concerned.
    """

    def __init__(
        self,
        stream_index: int,
        tag: str,
        on_frames: OnFrames,
        close: Callable[[AppCapture], bool],
    ) -> None:
        self.stream_index = stream_index
        self.tag = tag
        self.samplerate = self.channels = 0
        self.audible = True
        self.silenced = 0
        self.opened_s = self.last_callback_s = time.monotonic()
        self.callbacks = 0
        self.frames = 0
        self.xruns = 0
        self.errors: dict[str, int] = {}
        self.ended: EndReason | None = None
        self._on_frames = on_frames
        self._close = close
        self._handle: Any = None
        self._pending = True  # the server has not yet said that the stream runs
        self._failed = False  # it ended the stream, and was not asked yet why
        self._data, self._size = ctypes.c_void_p(), ctypes.c_size_t()

    def is_lost(self, now_s: float | None = None) -> bool:
        """Whether it has ended; an application that pauses is not lost, though nothing may come.

        now_s: not needed here; other captures take it. Any thread may call it.
        """
        return self.ended is not None

    def is_active(self) -> bool:
        """Whether it has not ended. Any thread may call it."""
        return self.ended is None

    def close(self) -> bool:
        """End the capture; whether that was done in time.

        Any thread but the one that calls on_frames may call this, again too; it raises nothing.
        Once it returns True, on_frames is not called any more.
        """
        if self.ended is None:
            self.ended = EndReason.CLOSED
        return self._close(self)

    # -------------------------------------------------------------- on the connection's thread

    def _start(self, handle: Any, samplerate: int, channels: int) -> None:
        """It runs from now on, with this stream of libpulse."""
        self._handle, self.samplerate, self.channels = handle, samplerate, channels
        self._pending, self._failed = True, False
        self.opened_s = self.last_callback_s = time.monotonic()

    def _stop(self) -> Any:
        """It runs no more; the stream of libpulse that it had, None if none."""
        handle, self._handle = self._handle, None
        return handle

    def _read(self, library: libpulse.LibPulse) -> None:
        """Pass on everything that has come, as one buffer.

        PulseAudio cuts fragments where the application's own buffers end: a few frames would come
        apart from the rest of their cycle.
        """
        handle, data, size = self._handle, self._data, self._size
        if handle is None or self._failed or (self._pending and not self._is_ready(library)):
            return
        pieces: list[bytes] = []
        while library.stream_peek(handle, byref(data), byref(size)) >= 0:
            if not size.value:
                if pieces and self.ended is None:
                    self._deliver(pieces[0] if len(pieces) == 1 else b"".join(pieces))
                return
            if data.value:
                pieces.append(string_at(data.value, size.value))
            else:  # a hole
                self.xruns += 1
                pieces.append(bytes(size.value))
            library.stream_drop(handle)
        self._failed = True

    def _is_ready(self, library: libpulse.LibPulse) -> bool:
        """Whether the stream has begun to run."""
        state = library.stream_get_state(self._handle)
        if state < libpulse.STREAM_READY:
            return False
        self._pending = False
        if state == libpulse.STREAM_READY:
            # what an application plays to has a monitor: no microphone, whatever the server does
            name: bytes | None = library.stream_get_device_name(self._handle)
            self._failed = bool(name) and not (name or b"").endswith(b".monitor")
        else:
            self._failed = True
        return not self._failed

    def _deliver(self, data: bytes) -> None:
        now_s = time.monotonic()
        try:
            self.last_callback_s = now_s
            self.callbacks += 1
            if not self.audible:
                self.silenced += 1
                data = bytes(len(data))
            frames = np.frombuffer(data, np.float32).reshape(-1, self.channels)
            self.frames += len(frames)
            self._on_frames(frames, now_s)
        except BaseException as error:  # nothing may pass: other captures go on
            name = type(error).__name__
            if name not in self.errors and len(self.errors) >= _ERROR_NAMES:
                name = "others"
            self.errors[name] = self.errors.get(name, 0) + 1
