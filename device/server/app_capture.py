"""Captures one application's sound before the server mixes it.

A server can record a single playing stream (sink input) if the recording stream requests it.
PortAudio and ALSA cannot request that. Volume and mute of the playing stream act on the captured
sound; those of its sink do not. At volume 100 % and the stream's own rate, samples are unchanged.

PulseAudio ends the capture when the application's stream moves to another sink. While the
application pauses, PulseAudio delivers silence, and PipeWire delivers nothing.
"""

import ctypes
import itertools
import os
import sys
import time
from collections.abc import Callable
from ctypes import byref, string_at
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from device.server import libpulse
from device.stream.pcms import APPLICATION_ID, APPLICATION_NAME, ROLE, TAG
from device.stream.streams import CallbackCounts, OnBlock

FRAGMENT_FRAMES = 256  # frames that the server collects before a delivery: 5.3 ms at 48 kHz
BACKLOG_S = 0.5  # the server keeps this much sound while the capturing thread is delayed
_FLAGS = (
    libpulse.STREAM_DONT_MOVE
    | libpulse.STREAM_ADJUST_LATENCY
    | libpulse.STREAM_DONT_INHIBIT_AUTO_SUSPEND  # a card may suspend while the application pauses
)
_FLOAT32 = libpulse.FLOAT32_LE if sys.byteorder == "little" else libpulse.FLOAT32_BE
_numbers = itertools.count(1)


class EndReason(StrEnum):
    """Why a capture has ended, as a text for users."""

    GONE = "the application's stream has ended"
    TAKEN = "the server ended the capture, as happens when the application's stream moves"
    LOST = "the sound server was lost"
    CLOSED = "the capture was closed"


@dataclass(frozen=True)
class PlayingStream:
    """An application's playing stream. paused: whether the application has paused it."""

    name: str
    channels: int
    channel_map: Any
    paused: bool


class AppCapture(CallbackCounts):
    """Delivers the frames of one application's stream. `AppCaptures.open` returns the object.

    Any thread may read the attributes. stream_index: index of the sink input. ended: why the
    capture ended; None while it runs. xruns: number of gaps in the sound, filled with silence. The
    other attributes are as in `CaptureStream`.
    """

    def __init__(
        self,
        stream_index: int,
        samplerate: int,
        channels: int,
        on_frames: OnBlock,
        close: Callable[["AppCapture"], bool],
    ) -> None:
        super().__init__(audible=True)
        self.stream_index = stream_index
        self.tag = f"{os.getpid()}-app-{next(_numbers)}"
        self.ended: EndReason | None = None
        self._samplerate, self._channels = samplerate, channels
        self._on_frames, self._close = on_frames, close
        self._handle: Any = None
        self._pending = True  # the server has not yet reported the stream as ready
        self._failed = False  # the stream has ended or may not be used
        self._data, self._size = ctypes.c_void_p(), ctypes.c_size_t()

    def close(self) -> bool:
        """End the capture; return whether it ended in time. on_frames must not call this."""
        self.ended = self.ended or EndReason.CLOSED
        return self._close(self)

    # -------------------------------------------------------------- on the connection's thread

    def _start(self, library: libpulse.LibPulse, context: Any, playing: PlayingStream) -> bool:
        """Request a stream that records the application; return whether libpulse accepts it."""
        positions = playing.channel_map
        if self._channels != playing.channels:
            positions = library.types.PA_CHANNEL_MAP()
            library.channel_map_init_extend(byref(positions), self._channels, libpulse.DEFAULT_MAP)
        frame_bytes = 4 * self._channels
        sizes = library.types.PA_BUFFER_ATTR(
            maxlength=int(BACKLOG_S * self._samplerate) * frame_bytes,
            fragsize=FRAGMENT_FRAMES * frame_bytes,
        )
        known = {
            "application.id": APPLICATION_ID,
            "application.name": APPLICATION_NAME,
            "media.role": ROLE,
            TAG: self.tag,
            "node.dont-reconnect": "true",  # PipeWire's form of STREAM_DONT_MOVE
        }
        with library.properties(known) as properties:
            handle = library.stream_new_with_proplist(
                context,
                f"{playing.name} (captured)".encode(),
                byref(library.types.PA_SAMPLE_SPEC(_FLOAT32, self._samplerate, self._channels)),
                byref(positions),
                properties,
            )
        if not handle:
            return False
        if (
            library.stream_set_monitor_stream(handle, self.stream_index) < 0
            or library.stream_connect_record(handle, None, byref(sizes), _FLAGS) < 0
        ):
            library.stream_unref(handle)
            return False
        self._handle, self._pending, self._failed = handle, True, False
        self.opened_s = self.last_callback_s = time.monotonic()
        return True

    def _read(self, library: libpulse.LibPulse) -> None:
        """Join all pieces of sound that have arrived, and deliver them as one block."""
        handle, data, size = self._handle, self._data, self._size
        if handle is None or self._failed or (self._pending and not self._is_ready(library)):
            return
        pieces: list[bytes] = []
        while library.stream_peek(handle, byref(data), byref(size)) >= 0:
            if not size.value:
                if pieces and self.ended is None:
                    self._deliver(b"".join(pieces))
                return
            if data.value:
                pieces.append(string_at(data.value, size.value))
            else:  # a gap
                self.xruns += 1
                pieces.append(bytes(size.value))
            library.stream_drop(handle)
        self._failed = True

    def _is_ready(self, library: libpulse.LibPulse) -> bool:
        if (state := library.stream_get_state(self._handle)) < libpulse.STREAM_READY:
            return False
        self._pending, self._failed = False, True
        if state == libpulse.STREAM_READY:
            # Only a monitor is permitted, never a microphone.
            name: bytes = library.stream_get_device_name(self._handle) or b".monitor"
            self._failed = not name.endswith(b".monitor")
        return not self._failed

    def _deliver(self, data: bytes) -> None:
        now_s = time.monotonic()
        try:
            self.last_callback_s = now_s
            self.callbacks += 1
            frames = np.frombuffer(data, np.float32).reshape(-1, self._channels)
            self.frames += len(frames)
            self._on_frames(frames, now_s)
        except BaseException as error:  # other captures continue
            self._count(error)
