"""A stream to a sound server or sound card. The stream is reopened after a failure."""

from collections.abc import Callable
from typing import Generic, TypeVar

from audioflinger_hook.daemon.timing import Backoff
from audioflinger_hook.service.state import Cause, StateKeeper
from device.errors import CushionError, NotFoundError
from device.server import PulseConnection, StreamGuard
from device.server.guard import Hold
from device.stream import CaptureStream, PlaybackStream

SETTLES_S = 1.0  # after opening, the server may report another device for this time
ASTRAY_S = 0.4  # longest time on another device; a program may move the stream back
GONE_S = 3.0  # longest absence of a stream from the server's list, such as in underruns

StreamT = TypeVar("StreamT", CaptureStream, PlaybackStream)


class ReconnectingStream(Generic[StreamT]):
    """Opens one stream and its `StreamGuard`, and reopens both after failures.

    what: subject of messages, such as "the output". lost, moved: causes to report if the stream is
    lost or moved. stream: None while closed. guard: None while closed, and always None on a card.
    """

    def __init__(self, what: str, states: StateKeeper, lost: Cause, moved: Cause) -> None:
        self._what, self._states = what, states
        self._lost, self._moved = lost, moved
        self._backoff = Backoff()
        self._xruns_before = 0
        self.stream: StreamT | None = None
        self.guard: StreamGuard | None = None

    @property
    def xruns(self) -> int:
        """Number of buffers that PortAudio reported as late since the first opening."""
        return self._xruns_before + (self.stream.xruns if self.stream else 0)

    def check(self, now_s: float) -> None:
        """Close the stream if it stopped, or was missing or on another device for too long."""
        stream, guard = self.stream, self.guard
        if stream is None:
            return
        if stream.is_lost(now_s):
            self._states.recover(self._lost, now_s, f"{self._what} stopped")
            self.close()
        elif guard is not None and now_s - stream.opened_s > SETTLES_S:
            limit_s = GONE_S if guard.hold is Hold.NO_STREAM else ASTRAY_S
            if guard.misplaced_s(now_s) > limit_s:
                self._states.recover(self._moved, now_s, guard.hold.value)
                self.close()

    def open(
        self,
        make: Callable[[], StreamT],
        connection: PulseConnection | None,
        device_name: str,
        now_s: float,
    ) -> bool:
        """Open a closed stream if an attempt is due; return whether the stream was opened.

        connection: None for a card; its stream plays immediately. An error delays the next attempt.
        """
        if self.stream is not None or self._backoff.wait_s(now_s) > 0.0:
            return False
        try:
            # If an opening fails beside a running stream, PortAudio 19 may end the whole process.
            if connection is not None and not connection.has_device(device_name):
                raise NotFoundError(f"the sound server has no device {device_name!r} any more")
            self.stream = make()
            if connection is not None:
                self.guard = StreamGuard(connection, self.stream, device_name)
            else:
                self.stream.audible = True
        except CushionError:
            self._backoff.failed(now_s)
            self.close()
            raise
        self._backoff.succeeded()
        return True

    def close(self) -> None:
        """Close the stream and its guard. Repeated calls do nothing."""
        if self.guard:
            self.guard.release()
        if self.stream:
            self.stream.close()
            self._xruns_before += self.stream.xruns
        self.guard = self.stream = None
