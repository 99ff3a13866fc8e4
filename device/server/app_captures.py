"""Captures of applications: all share one libpulse connection and one thread.

The connection is separate from `PulseConnection`, whose queries would delay sound.
"""

import itertools
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from device.errors import CushionError, LostError, NotFoundError
from device.server import libpulse
from device.server.app_capture import AppCapture, EndReason, PlayingStream
from device.server.connection_thread import ANSWER_LIMIT_S, ConnectionThread, no_server, where
from device.stream.pcms import APPLICATION_ID, APPLICATION_NAME
from device.stream.streams import OnBlock

ATTEMPTS = 3  # PipeWire occasionally refuses a stream on a busy machine
START_LIMIT_S = 0.5  # longest wait for the first sound of a playing application
_QUERY_AFTER_S = 1.0  # after this time without a message, a query tests whether the server answers


class AppCaptures(ConnectionThread):
    """Opens captures of applications. The constructor connects to the server.

    `close` ends all captures. The object's own thread calls on_frames; any other thread may call
    the methods. lost: why all captures were lost, or None; make a new object after a loss.
    LostError: no server answers. NotFoundError: pulsectl or libpulse is not installed.
    """

    def __init__(self) -> None:
        self._captures: list[AppCapture] = []
        self._dropped: list[Any] = []
        self._library = libpulse.load()
        self._loop: Any = None
        self._context: Any = None
        self._numbers = itertools.count(1)
        self._answers: dict[int, PlayingStream | None] = {}
        self._heard_s = time.monotonic()
        types = self._library.types
        self._info_callback = types.PA_SINK_INPUT_INFO_CB_T(self._take_info)
        self._event_callback = types.PA_SUBSCRIBE_CB_T(self._take_event)
        super().__init__("app-captures")

    def open(
        self, stream_index: int, samplerate: int, channels: int, on_frames: OnBlock
    ) -> AppCapture:
        """Return a running capture of the playing stream (sink input) with this index.

        The server converts the sound to this samplerate (Hz) and number of channels. PipeWire
        captures a paused application only after the application continues. on_frames: called by
        this object's thread with read-only frames and their arrival time. on_frames may keep the
        frames, and must neither wait nor open or close captures. NotFoundError: no playing stream
        has this index. LostError: the connection is lost, or the server refuses or is too slow.
        """
        capture = AppCapture(stream_index, samplerate, channels, on_frames, self._close)
        try:
            self._ask(lambda: self._start_capture(capture))
        except CushionError:
            capture.close()  # the server may still make the stream later
            raise
        return capture

    def _close(self, capture: AppCapture) -> bool:
        if threading.current_thread() is self._thread:
            return False  # `_maintain` closes the stream, because `ended` is set
        try:
            self._ask(lambda: self._give_up(capture))
        except LostError:
            return self._ended
        return True

    # ------------------------------------------------------------------ on the connection's thread

    def _start_capture(self, capture: AppCapture) -> None:
        if capture.ended:  # the caller has closed the capture
            return
        index = capture.stream_index
        gone = NotFoundError(
            f"no application plays a stream with the index {index}, or it ended just now; "
            "`pactl list short sink-inputs` shows those that play"
        )
        self._captures.append(capture)  # from now on `_take_event` detects the end of the stream
        try:
            if (playing := self._find_playing(index)) is None:
                raise gone
            for _ in range(ATTEMPTS):
                self._drop_stream(capture)
                if not capture._start(self._library, self._context, playing):
                    break
                # PipeWire reports the stream as ready only when the application plays.
                limit_s = 0.0 if playing.paused else START_LIMIT_S
                self._wait_for(lambda: not capture._pending, limit_s)
                runs = not capture._pending and not capture._failed
                if capture.ended or not (runs or self._find_playing(index)):
                    raise gone
                if not capture._failed:
                    return
            raise LostError(
                f"the sound server does not capture stream {index} ({self._reason()}); "
                "try again, as it may be moving, or tap its sink"
            )
        except BaseException:
            self._give_up(capture)
            raise

    def _maintain(self) -> None:
        for capture in tuple(self._captures):
            if capture._failed and capture.ended is None:
                plays = self._find_playing(capture.stream_index) is not None
                capture.ended = EndReason.TAKEN if plays else EndReason.GONE
            if capture.ended is not None:
                self._give_up(capture)

    def _give_up(self, capture: AppCapture) -> None:
        with suppress(ValueError):
            self._captures.remove(capture)
        capture.ended = capture.ended or EndReason.CLOSED
        self._drop_stream(capture)

    def _drop_stream(self, capture: AppCapture) -> None:
        handle, capture._handle = capture._handle, None
        if handle is not None:
            self._dropped.append(handle)
            self._close_left()

    def _close_left(self) -> None:
        """Close unused streams that are ready or have failed; libpulse cannot close others."""
        for handle in tuple(self._dropped):
            if self._library.stream_get_state(handle) >= libpulse.STREAM_READY:
                self._dropped.remove(handle)
                self._library.stream_disconnect(handle)  # no effect on a stream that has ended
                self._library.stream_unref(handle)

    def _wake_up(self) -> None:
        if self._loop is not None:
            self._library.mainloop_wakeup(self._loop)

    def _open(self) -> None:
        library = self._library
        with self._gate:
            self._loop = library.mainloop_new()
        api = library.mainloop_get_api(self._loop)
        with library.properties({"application.id": APPLICATION_ID}) as properties:
            self._context = library.context_new_with_proplist(
                api, APPLICATION_NAME.encode(), properties
            )
        flags, ready = libpulse.CONTEXT_NOAUTOSPAWN, libpulse.CONTEXT_READY
        try:
            if library.context_connect(self._context, None, flags, None) < 0:
                raise LostError(self._reason())
            self._wait_for_answer(lambda: library.context_get_state(self._context) == ready)
        except LostError:
            raise no_server() from None
        library.context_set_subscribe_callback(self._context, self._event_callback, None)
        events = libpulse.SUBSCRIBE_SINK_INPUTS
        library.operation_unref(library.context_subscribe(self._context, events, None, None))

    def _serve(self) -> None:
        while not self._stopping:
            self._step(_QUERY_AFTER_S / 2 if self._captures else None)
            self._do_requests()
            self._maintain()
            if self._captures and time.monotonic() - self._heard_s >= _QUERY_AFTER_S:
                self._find_playing(0)  # raises LostError if the server hangs

    def _step(self, limit_s: float | None, for_requests: bool = True) -> None:
        """Wait for the server, with `for_requests` also for requests; then read the streams."""
        library, loop = self._library, self._loop
        prepared = library.mainloop_prepare(loop, -1 if limit_s is None else int(limit_s * 1e6))
        # `mainloop_prepare` clears earlier wake-ups
        if self._stopping or (for_requests and not self._requests.empty()):
            library.mainloop_wakeup(loop)
        if prepared < 0 or library.mainloop_poll(loop) < 0:
            raise self._no_answer()
        if library.mainloop_dispatch(loop) > 0:
            self._heard_s = time.monotonic()
        if library.context_get_state(self._context) >= libpulse.CONTEXT_FAILED:
            raise self._loss()
        for capture in self._captures:
            capture._read(library)
        if self._dropped:
            self._close_left()

    def _wait_for(self, condition: Callable[[], bool], limit_s: float) -> bool:
        """Read streams until the condition is true; return False if limit_s passes first."""
        deadline_s = time.monotonic() + limit_s
        while not condition():
            if self._stopping:
                raise LostError("the connection to the sound server is closed")
            if (left_s := deadline_s - time.monotonic()) <= 0.0:
                return False
            self._step(left_s, for_requests=False)
        return True

    def _wait_for_answer(self, condition: Callable[[], bool]) -> None:
        if not self._wait_for(condition, ANSWER_LIMIT_S):
            raise self._no_answer()

    def _find_playing(self, stream_index: int) -> PlayingStream | None:
        number = next(self._numbers)
        operation = self._library.context_get_sink_input_info(
            self._context, stream_index, self._info_callback, number
        )
        if not operation:
            raise self._loss()
        self._library.operation_unref(operation)
        self._wait_for_answer(lambda: number in self._answers)
        return self._answers.pop(number)

    def _take_info(self, context: Any, info: Any, end: int, number: int) -> None:
        if end:
            self._answers.setdefault(number, None)
            return
        found = info.contents
        self._answers[number] = PlayingStream(
            (found.name or b"").decode("utf-8", "replace"),
            found.sample_spec.channels,
            self._library.types.PA_CHANNEL_MAP.from_buffer_copy(found.channel_map),
            bool(found.corked),
        )

    def _take_event(self, context: Any, what: int, index: int, _: Any) -> None:
        if what & libpulse.EVENT_MASK == libpulse.EVENT_SINK_INPUT_REMOVED:
            for capture in self._captures:
                if capture.stream_index == index and capture.ended is None:
                    capture.ended = EndReason.GONE

    def _reason(self) -> str:
        code = self._library.context_errno(self._context)
        return str(self._library.strerror(code).decode("utf-8", "replace"))

    def _loss(self) -> LostError:
        return LostError(f"the sound server{where()} was lost ({self._reason()})")

    def _disconnect(self) -> None:
        for capture in tuple(self._captures):
            capture.ended = capture.ended or (EndReason.LOST if self.lost else EndReason.CLOSED)
            self._give_up(capture)
        while self._dropped:
            self._library.stream_unref(self._dropped.pop())
        if self._context is not None:
            self._library.context_disconnect(self._context)
            self._library.context_unref(self._context)

    def _free(self) -> None:
        loop, self._loop = self._loop, None
        if loop is not None:
            self._library.mainloop_free(loop)
