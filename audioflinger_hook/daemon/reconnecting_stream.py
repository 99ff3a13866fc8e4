"""A stream of the sound server or a card, kept: opened, watched, given up and opened again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from audioflinger_hook.service.backoff import Backoff
from audioflinger_hook.service.state import Cause, StateKeeper
from device.errors import CushionError
from device.server import PulseConnection, StreamGuard
from device.server.guard import Hold
from device.stream import CaptureStream, PlaybackStream

SETTLES_S = 1.0
"""How long a stream may take from its opening until the server shows it where it belongs."""

ASTRAY_S = 0.4
"""A stream that is elsewhere for less is perhaps being put right by somebody else."""

GONE_S = 3.0
"""The server may be without a stream that runs for so long: one underrun follows another then."""

LONGEST_WAIT_S = 0.5
"""Between attempts to open: asking costs the server and us next to nothing."""

StreamT = TypeVar("StreamT", CaptureStream, PlaybackStream)


class ReconnectingStream(Generic[StreamT]):
    """One stream, its guard, and when to open it again. For the supervising thread alone.

    what: for reasons, as in "the output". lost, moved: what a stream counts as that stopped, or
    that the server put elsewhere. stream: None while it is closed. guard: of the stream, None for
    one that no server can put elsewhere.
    """

    def __init__(self, what: str, states: StateKeeper, lost: Cause, moved: Cause) -> None:
        self._what = what
        self._states = states
        self._lost = lost
        self._moved = moved
        self._backoff = Backoff(longest_s=LONGEST_WAIT_S)
        self._xruns_before = 0
        self.stream: StreamT | None = None
        self.guard: StreamGuard | None = None

    @property
    def xruns(self) -> int:
        """How often PortAudio told of lateness, over all openings."""
        return self._xruns_before + (self.stream.xruns if self.stream else 0)

    def check(self, now_s: float) -> None:
        """Give the stream up if it stopped or is not where it belongs."""
        stream, guard = self.stream, self.guard
        if stream is None:
            return
        if stream.is_lost(now_s):
            self._states.recover(self._lost, now_s, f"{self._what} stopped")
        elif guard is None:
            return
        elif now_s - stream.opened_s > SETTLES_S and _is_misplaced(guard, now_s):
            self._states.recover(self._moved, now_s, guard.hold.value)
        else:
            return
        self.close()

    def open(
        self,
        make: Callable[[], StreamT],
        connection: PulseConnection | None,
        device_name: str,
        now_s: float,
    ) -> bool:
        """Open the stream if it is closed and an attempt is due; whether it was opened.

        connection: to the server that has the device; None for a card itself, whose stream needs no
        guard and is audible at once.

        Raises what `make` raises, and LostError from the guard; the next attempt waits then.
        """
        if self.stream is not None or self._backoff.wait_s(now_s) > 0.0:
            return False
        try:
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
        """Fall silent and close. Again too; it raises nothing."""
        guard, stream = self.guard, self.stream
        if guard:
            guard.release()
        if stream:
            stream.close()
            self._xruns_before += stream.xruns
        self.guard = self.stream = None


def _is_misplaced(guard: StreamGuard, now_s: float) -> bool:
    """Whether its stream will not come back to its place by itself."""
    return guard.misplaced_s(now_s) > (GONE_S if guard.hold is Hold.NO_STREAM else ASTRAY_S)
