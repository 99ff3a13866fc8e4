"""Opens captures of applications: one connection and one thread for all of them.

The connection is one of its own, beside `PulseConnection`: sound comes on it hundreds of times a
second, and nothing that asks what the server holds may hold that up.
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
from device.server.pulse_thread import Playing, PulseThread
from device.stream.pcms import APPLICATION_ID, APPLICATION_NAME, ROLE, TAG
from device.stream.streams import OnFrames, check_format

FRAGMENT_FRAMES = 256
"""What the server gathers before it delivers: 5.3 ms at 48 kHz."""

BACKLOG_S = 0.5
"""What the server keeps for us while we are held up; older sound is dropped."""

ATTEMPTS = 3
"""PipeWire now and then refuses a stream on a busy machine, where links are made late."""

START_LIMIT_S = 0.5
"""How long an opening waits for the first sound of an application that does not pause."""

_FLAGS = (
    libpulse.STREAM_DONT_MOVE
    | libpulse.STREAM_ADJUST_LATENCY
    | libpulse.STREAM_DONT_INHIBIT_AUTO_SUSPEND  # a card may sleep while the application pauses
)
_FLOAT32 = libpulse.FLOAT32_LE if sys.byteorder == "little" else libpulse.FLOAT32_BE
_numbers = itertools.count(1)


class AppCaptures(PulseThread):
    """Opens captures of applications; connected from the moment it is made.

    server: its address, None for the usual one. lost: why the connection is lost, None while it is
    not; all captures have ended then, and another AppCaptures is made to connect again. `close`
    ends all captures. Any thread but its own, which calls on_frames, may call the methods.

    Raises
    ------
    LostError
        No server answers there.
    NotFoundError
        The library libpulse is not installed.
    """

    def __init__(self, server: str | None = None) -> None:
        self._captures: list[AppCapture] = []
        self._leaving: list[Any] = []
        super().__init__(server, "app-captures")

    def open(
        self,
        stream_index: int,
        samplerate: int | None,
        channels: int | None,
        on_frames: OnFrames,
    ) -> AppCapture:
        """A capture of the stream (sink input) that plays with this index; it runs from now on.

        samplerate: Hz; None takes the application's own, but the sink's saves converting twice.
        channels: None takes the application's own. The server converts. An application that
        pauses is captured from the moment that it goes on.

        on_frames(frames, now_s): called by the thread that all captures share, with float32
        (frames, channels), read only, which may be kept, and the time of their arrival in seconds
        of time.monotonic(). Mostly it is one fragment of FRAGMENT_FRAMES; after a delay it may be
        up to BACKLOG_S at once. It must neither block nor open or close captures; what it raises
        is counted in `errors`.

        Raises
        ------
        NotFoundError
            No application plays a stream with this index, or it ended just now.
        LostError
            The connection is lost, or the server refuses or does not answer in time.
        UsageError
            samplerate or channels is not possible.
        """
        check_format(
            48_000 if samplerate is None else samplerate, 2 if channels is None else channels
        )
        capture = AppCapture(
            stream_index, f"{os.getpid()}-app-{next(_numbers)}", on_frames, self._close
        )
        try:
            self._ask(lambda: self._open(capture, samplerate, channels))
        except CushionError:
            capture.close()  # a server that was merely late may still make it
            raise
        return capture

    def _close(self, capture: AppCapture) -> bool:
        if threading.current_thread() is self._thread:
            return False  # given up in the next round, since it says that it has ended
        try:
            self._ask(lambda: self._give_up(capture))
        except LostError:
            return self._ended
        return True

    # ---------------------------------------------------------------------- on the own thread

    def _on_step(self) -> None:
        for capture in self._captures:
            capture._read(self._library)
        if self._leaving:
            self._let_go()

    def _on_round(self) -> None:
        for capture in tuple(self._captures):
            if capture._failed and capture.ended is None:
                plays = self._playing(capture.stream_index) is not None
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
        while self._leaving:
            self._library.stream_unref(self._leaving.pop())

    def _streams_run(self) -> bool:
        return bool(self._captures)

    def _open(self, capture: AppCapture, samplerate: int | None, channels: int | None) -> None:
        if capture.is_lost():  # whoever asked has given up since
            return
        self._captures.append(capture)  # from now on the end of its application is noticed
        try:
            playing = self._playing(capture.stream_index)
            if playing is None:
                raise NotFoundError(_no_stream(capture.stream_index))
            samplerate, channels = samplerate or playing.samplerate, channels or playing.channels
            for attempt in range(1, ATTEMPTS + 1):
                handle = self._connected(capture, playing, samplerate, channels)
                capture._start(handle, samplerate, channels)
                # PipeWire says that the stream is ready only once the application plays.
                self._comes(lambda: not capture._pending, 0.0 if playing.paused else START_LIMIT_S)
                runs = not capture._pending and not capture._failed
                if capture.is_lost() or not (runs or self._playing(capture.stream_index)):
                    raise NotFoundError(_no_stream(capture.stream_index))
                if not capture._failed:
                    return
                if attempt == ATTEMPTS:
                    raise LostError(self._refusal(capture))
                self._leave(capture)
        except BaseException:
            self._give_up(capture)
            raise

    def _connected(
        self, capture: AppCapture, playing: Playing, samplerate: int, channels: int
    ) -> Any:
        """A stream of libpulse that is to record what this capture is for."""
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
            "node.dont-reconnect": "true",  # what STREAM_DONT_MOVE becomes on PipeWire
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
        self._leave(capture)

    def _leave(self, capture: AppCapture) -> None:
        """End the stream that a capture has, if any."""
        handle = capture._stop()
        if handle is not None:
            self._leaving.append(handle)
            self._let_go()

    def _let_go(self) -> None:
        """End the streams that are not wanted any more; libpulse cannot before they are ready."""
        for handle in tuple(self._leaving):
            if self._library.stream_get_state(handle) >= libpulse.STREAM_READY:
                self._leaving.remove(handle)
                self._library.stream_disconnect(handle)  # in vain if the server has ended it
                self._library.stream_unref(handle)

    def _refusal(self, capture: AppCapture) -> str:
        return (
            f"the sound server does not capture stream {capture.stream_index} ({self._reason()}); "
            "try again, as it may just be moved, or tap its sink"
        )


def _no_stream(stream_index: int) -> str:
    return (
        f"no application plays a stream with the index {stream_index}, or it ended just now; "
        "`pactl list short sink-inputs` shows those that play"
    )
