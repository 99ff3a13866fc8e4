"""One application's sound, captured before the mix.

A server records one playing stream (sink input) if the record stream asks for that when it is
made; PortAudio and ALSA cannot. On PulseAudio 16.1 and PipeWire 0.3.65 the sound comes after the
application's own volume and mute, and before the sink's. At 100 % and equal rates the samples are
bit-identical.

The capture cannot be moved, and the server ends it with the application's stream. PulseAudio also
ends it when that stream moves to another sink; PipeWire continues. While the application pauses,
PulseAudio delivers silence and PipeWire nothing.
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
    """Why a capture has ended, as a text for users."""

    GONE = "the application's stream has ended"
    TAKEN = "the server ended the capture, as happens when the application's stream moves"
    LOST = "the sound server was lost"
    CLOSED = "the capture was closed"


class AppCapture:
    """Delivers the frames of one application's stream. Made by `AppCaptures.open`.

    Any thread may read the attributes:

    stream_index: of the sink input. tag: value of the property `pcms.TAG`. samplerate: Hz.
    opened_s: time of opening. last_callback_s: time of the last frames, opened_s before the first.
    callbacks, frames: counts so far; callbacks differ in length. xruns: how often the server
    reported missing frames, which become silence. errors: exceptions in on_frames, by name.
    ended: None while it runs, else the reason.

    audible: any thread may set it. While it is False, the frames are 0. silenced: how many
    callbacks that affected.
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
        self._pending = True  # the server has not reported the stream as ready
        self._failed = False  # the server ended the stream; the reason is not known yet
        self._data, self._size = ctypes.c_void_p(), ctypes.c_size_t()

    def is_lost(self, now_s: float | None = None) -> bool:
        """Whether it has ended; now_s is not used. Any thread may call it.

        A paused application is not lost, though no frames may come.
        """
        return self.ended is not None

    def close(self) -> bool:
        """End the capture; whether that was in time.

        After True, on_frames is not called any more. Any thread but the one that calls on_frames
        may call this, more than once; it raises nothing.
        """
        if self.ended is None:
            self.ended = EndReason.CLOSED
        return self._close(self)

    # -------------------------------------------------------------- on the connection's thread

    def _start(self, handle: Any, samplerate: int, channels: int) -> None:
        """Start with this stream of libpulse."""
        self._handle, self.samplerate, self.channels = handle, samplerate, channels
        self._pending, self._failed = True, False
        self.opened_s = self.last_callback_s = time.monotonic()

    def _stop(self) -> Any:
        """Stop; returns the stream of libpulse that it had, or None."""
        handle, self._handle = self._handle, None
        return handle

    def _read(self, library: libpulse.LibPulse) -> None:
        """Deliver everything that has arrived as one buffer.

        PulseAudio splits fragments where the application's buffers end, a few frames apart.
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
            # only a monitor is valid, never a microphone
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
        except BaseException as error:  # other captures continue
            name = type(error).__name__
            if name not in self.errors and len(self.errors) >= _ERROR_NAMES:
                name = "others"
            self.errors[name] = self.errors.get(name, 0) + 1
