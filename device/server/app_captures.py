"""Captures of applications: one connection and one thread for all of them.

They use another connection than `PulseConnection`: sound arrives hundreds of times per second, and
queries must not delay it.
"""

from __future__ import annotations

import itertools
import os
import sys
import threading
from typing import Any

from device.errors import CushionError, LostError, NotFoundError
from device.server import libpulse
from device.server.app_capture import AppCapture, EndReason
from device.server.record_connection import PlayingStream, RecordConnection
from device.stream.pcms import APPLICATION_ID, APPLICATION_NAME, ROLE, TAG
from device.stream.streams import OnFrames, check_format

FRAGMENT_FRAMES = 256
"""Frames that the server gathers before it delivers: 5.3 ms at 48 kHz."""

BACKLOG_S = 0.5
"""Sound that the server keeps while this thread is delayed; older sound is dropped."""

ATTEMPTS = 3
"""PipeWire occasionally refuses a stream on a busy machine, where links are made late."""

START_LIMIT_S = 0.5
"""How long an opening waits for the first sound of an application that plays."""

_FLAGS = (
    libpulse.STREAM_DONT_MOVE
    | libpulse.STREAM_ADJUST_LATENCY
    | libpulse.STREAM_DONT_INHIBIT_AUTO_SUSPEND  # a card may sleep while the application pauses
)
_FLOAT32 = libpulse.FLOAT32_LE if sys.byteorder == "little" else libpulse.FLOAT32_BE
_numbers = itertools.count(1)


class AppCaptures(RecordConnection):
    """Opens captures of applications; connected from the moment it is made.

    `close` ends all captures. Any thread but its own, which calls on_frames, may call the methods.

    Attributes
    ----------
    lost : LostError or None
        Why the connection was lost; all captures have ended then. Make another object to connect
        again.

    Raises
    ------
    LostError
        No server answers.
    NotFoundError
        The library libpulse is not installed.
    """

    def __init__(self) -> None:
        self._captures: list[AppCapture] = []
        self._dropped: list[Any] = []
        super().__init__("app-captures")

    def open(
        self,
        stream_index: int,
        samplerate: int | None,
        channels: int | None,
        on_frames: OnFrames,
    ) -> AppCapture:
        """Return a running capture of the playing stream (sink input) with this index.

        samplerate (Hz), channels: the server converts to them; None takes the application's own.
        The sink's rate avoids a second conversion. A paused application is captured once it
        continues.

        on_frames(frames, now_s): called by the thread that all captures share, with read-only
        float32 (frames, channels), which it may keep, and the time of arrival in seconds of
        time.monotonic(). It gets FRAGMENT_FRAMES at a time, or up to BACKLOG_S after a delay. It
        must neither block nor open or close captures; its exceptions are counted in `errors`.

        Raises
        ------
        NotFoundError
            No application plays a stream with this index.
        LostError
            The connection is lost, or the server refuses or does not answer in time.
        UsageError
            samplerate or channels is out of range.
        """
        check_format(
            48_000 if samplerate is None else samplerate, 2 if channels is None else channels
        )
        capture = AppCapture(
            stream_index, f"{os.getpid()}-app-{next(_numbers)}", on_frames, self._close
        )
        try:
            self._ask(lambda: self._start_capture(capture, samplerate, channels))
        except CushionError:
            capture.close()  # a late server may still make it
            raise
        return capture

    def _close(self, capture: AppCapture) -> bool:
        if threading.current_thread() is self._thread:
            return False  # the next round gives it up, as it has ended
        try:
            self._ask(lambda: self._give_up(capture))
        except LostError:
            return self._ended
        return True

    # ------------------------------------------------------------------ on the connection's thread

    def _on_step(self) -> None:
        for capture in self._captures:
            capture._read(self._library)
        if self._dropped:
            self._close_left()

    def _on_round(self) -> None:
        for capture in tuple(self._captures):
            if capture._failed and capture.ended is None:
                plays = self._find_playing(capture.stream_index) is not None
                capture.ended = EndReason.TAKEN if plays else EndReason.GONE
            if capture.ended is not None:
                self._give_up(capture)

    def _on_removed(self, stream_index: int) -> None:
        for capture in self._captures:
            if capture.stream_index == stream_index and capture.ended is None:
                capture.ended = EndReason.GONE

    def _on_end(self) -> None:
        for capture in tuple(self._captures):
            capture.ended = capture.ended or (EndReason.LOST if self.lost else EndReason.CLOSED)
            self._give_up(capture)
        while self._dropped:
            self._library.stream_unref(self._dropped.pop())

    def _has_streams(self) -> bool:
        return bool(self._captures)

    def _start_capture(
        self, capture: AppCapture, samplerate: int | None, channels: int | None
    ) -> None:
        if capture.is_lost():  # the caller has given up
            return
        self._captures.append(capture)  # from now on its application's end is noticed
        try:
            playing = self._find_playing(capture.stream_index)
            if playing is None:
                raise NotFoundError(_no_stream(capture.stream_index))
            samplerate, channels = samplerate or playing.samplerate, channels or playing.channels
            for attempt in range(1, ATTEMPTS + 1):
                handle = self._connected(capture, playing, samplerate, channels)
                capture._start(handle, samplerate, channels)
                # PipeWire reports the stream as ready when the application plays.
                limit_s = 0.0 if playing.paused else START_LIMIT_S
                self._wait_for(lambda: not capture._pending, limit_s)
                runs = not capture._pending and not capture._failed
                if capture.is_lost() or not (runs or self._find_playing(capture.stream_index)):
                    raise NotFoundError(_no_stream(capture.stream_index))
                if not capture._failed:
                    return
                if attempt == ATTEMPTS:
                    raise LostError(self._refusal(capture))
                self._drop_stream(capture)
        except BaseException:
            self._give_up(capture)
            raise

    def _connected(
        self, capture: AppCapture, playing: PlayingStream, samplerate: int, channels: int
    ) -> Any:
        """Return a stream of libpulse that will record the capture's application."""
        library = self._library
        positions = playing.channel_map
        if channels != playing.channels:
            positions = libpulse.ChannelMap()
            library.channel_map_init_extend(positions, channels, libpulse.DEFAULT_MAP)
        frame_bytes = 4 * channels
        sizes = libpulse.BufferAttributes(
            maxlength=int(BACKLOG_S * samplerate) * frame_bytes,
            fragsize=FRAGMENT_FRAMES * frame_bytes,
        )
        known = {
            "application.id": APPLICATION_ID,
            "application.name": APPLICATION_NAME,
            "media.role": ROLE,
            TAG: capture.tag,
            "node.dont-reconnect": "true",  # PipeWire's form of STREAM_DONT_MOVE
        }
        with self._properties(known) as properties:
            handle = library.stream_new_with_proplist(
                self._context,
                f"{playing.name} (captured)".encode(),
                libpulse.SampleSpec(_FLOAT32, samplerate, channels),
                positions,
                properties,
            )
        if not handle:
            raise LostError(self._refusal(capture))
        if (
            library.stream_set_monitor_stream(handle, capture.stream_index) < 0
            or library.stream_connect_record(handle, None, sizes, _FLAGS) < 0
        ):
            library.stream_unref(handle)
            raise LostError(self._refusal(capture))
        return handle

    def _give_up(self, capture: AppCapture) -> None:
        if capture in self._captures:
            self._captures.remove(capture)
        capture.ended = capture.ended or EndReason.CLOSED
        self._drop_stream(capture)

    def _drop_stream(self, capture: AppCapture) -> None:
        """End the stream of a capture, if it has one."""
        handle = capture._stop()
        if handle is not None:
            self._dropped.append(handle)
            self._close_left()

    def _close_left(self) -> None:
        """Close dropped streams, which libpulse can do when they are ready."""
        for handle in tuple(self._dropped):
            if self._library.stream_get_state(handle) >= libpulse.STREAM_READY:
                self._dropped.remove(handle)
                self._library.stream_disconnect(handle)  # without effect if the server has ended it
                self._library.stream_unref(handle)

    def _refusal(self, capture: AppCapture) -> str:
        return (
            f"the sound server does not capture stream {capture.stream_index} ({self._reason()}); "
            "try again, as it may be moving, or tap its sink"
        )


def _no_stream(stream_index: int) -> str:
    return (
        f"no application plays a stream with the index {stream_index}, or it ended just now; "
        "`pactl list short sink-inputs` shows those that play"
    )
