"""Moves applications' streams to drop-in mode's virtual sink, and makes this sink the default.

The virtual sink is forwarded to a real sink, the target. Most streams follow a change of the
default sink; streams that stay on the target are moved. Times are in s of time.monotonic().
"""

from collections import deque
from collections.abc import Collection, Sequence
from contextlib import suppress

from device.errors import NotFoundError
from device.server.forwarding import SINK, carries_sound_of, is_application, reachable_sinks
from device.server.identity import find_sink
from device.server.pulse import PulseConnection
from device.server.snapshot import ServerSnapshot, Stream
from device.stream.pcms import ROLE

TAKES_S = 0.3  # time in which streams follow a new default sink
_CONTESTS, _CONTEST_S = 5, 10.0  # 5 new default sinks in 10 s come from a program, not from a user


def is_unused(snapshot: ServerSnapshot) -> bool:
    """Whether no stream plays to the virtual sink."""
    return not any(stream.device_name == SINK for stream in snapshot.sink_inputs)


class MovedStreams:
    """Moves streams to and from the virtual sink. all_here: whether none is left to collect."""

    def __init__(self, connection: PulseConnection) -> None:
        self.all_here = True
        self._connection = connection
        self._seen: set[int] = set()  # streams that have played to the virtual sink
        self._bypassing: dict[int, float] = {}  # streams on the target, and the time of detection
        self._before: dict[int, str] = {}  # by index of a stream: its last real sink
        self._homes: dict[int, str] = {}  # by index of a moved stream: its former sink

    def forget(self) -> None:
        """Treat all streams as new. Call this after a change of the target or the virtual sink."""
        self._seen.clear()
        self._homes.clear()

    def free_vibration(self, snapshot: ServerSnapshot, haptic_sink: str | None) -> None:
        """Move the vibration's stream from the virtual sink back to the haptic sink."""
        for stream in snapshot.sink_inputs:
            if stream.device_name == SINK and stream.role == ROLE and haptic_sink is not None:
                self._move(snapshot, stream, haptic_sink)

    def collect(self, snapshot: ServerSnapshot, target: str, now_s: float) -> None:
        """Move streams to the virtual sink if they have been on the target for TAKES_S.

        Streams of modules that forward the target's sound stay: they would form a loop. Streams
        that have already been on the virtual sink stay, because the user has moved them away.
        """
        loop = reachable_sinks(snapshot, target)
        astray: dict[int, float] = {}
        for stream in snapshot.sink_inputs:
            if stream.device_name == SINK:
                self._seen.add(stream.index)
            elif (
                stream.device_name == target
                and stream.index not in self._seen
                and is_application(stream)
                and not carries_sound_of(snapshot, stream, loop)
            ):
                since_s = astray[stream.index] = self._bypassing.get(stream.index, now_s)
                if now_s - since_s >= TAKES_S:
                    self._homes[stream.index] = target
                    self._move(snapshot, stream, SINK)
        self._bypassing = astray
        self.all_here = not astray

    def break_loop(self, snapshot: ServerSnapshot, target: str, others: Sequence[str]) -> bool:
        """Move streams that form a loop away from the virtual sink; return whether all moved.

        A stream moves to its former sink or to a sink of `others` that is outside the loop.
        """
        loop = reachable_sinks(snapshot, target)
        free = [name for name in others if name not in loop]
        places: dict[int, str] = {}
        broken = True
        for stream in snapshot.sink_inputs:
            before = self._before.get(stream.index, "")
            ours = stream.device_name == SINK
            if ours and carries_sound_of(snapshot, stream, loop):
                places_to_try = free if before in ("", *loop) else [before, *free]
                broken &= any(self._move(snapshot, stream, name) for name in places_to_try)
            places[stream.index] = before if ours else stream.device_name
        self._before = places
        return broken

    def restore(self, snapshot: ServerSnapshot, default: str) -> None:
        """Move back what `collect` moved; move other streams on the virtual sink to `default`."""
        for stream in snapshot.sink_inputs:
            home = default if stream.device_name == SINK else stream.device_name
            home = self._homes.get(stream.index, home)
            if stream.device_name != home and is_application(stream):
                self._move(snapshot, stream, home)

    def _move(self, snapshot: ServerSnapshot, stream: Stream, sink_name: str) -> bool:
        with suppress(NotFoundError):  # the stream has ended or may not move, or the sink is gone
            self._connection.move_sink_input(stream.index, find_sink(snapshot, sink_name).index)
            return True
        return False


class DefaultSinkClaim:
    """Makes the virtual sink the default, and detects another choice by the user.

    stable_name: name of the latest default sink that persisted, or SINK; any thread may set it.
    settled: whether the virtual sink became the default and no other choice was detected since.
    contested: whether another program keeps changing the default; this program leaves it then.
    """

    def __init__(self, connection: PulseConnection, stable_name: str) -> None:
        self.stable_name = stable_name
        self.settled = self.contested = False
        self._connection = connection
        self._taken_s: float | None = None
        self._choices: deque[float] = deque(maxlen=_CONTESTS)

    def detect_choice(
        self, snapshot: ServerSnapshot, now_s: float, fit: Collection[str]
    ) -> str | None:
        """Return the name of a newly chosen default sink, once for each choice; else None.

        fit: names of possible targets; such a sink is returned only after it persisted as default.
        """
        if (default := snapshot.default_sink) == SINK:
            self.settled, self.contested = True, False
        elif snapshot.sink(SINK) is None:
            self.settled = False  # the virtual sink is gone, and the server chose another default
        elif self.settled and default and (default == self.stable_name or default not in fit):
            self.settled = False
            self._choices.append(now_s)
            full = len(self._choices) == _CONTESTS
            self.contested = full and now_s - self._choices[0] < _CONTEST_S
            return default
        return None

    def claim(self, snapshot: ServerSnapshot, now_s: float) -> None:
        """Make the virtual sink the default; later calls repeat a request that had no effect."""
        if self.settled or self.contested or snapshot.default_sink == SINK:
            return
        if self._taken_s is None or now_s - self._taken_s >= TAKES_S:
            with suppress(NotFoundError):
                if self._taken_s is not None and snapshot.default_sink:
                    # WirePlumber ignores a request that equals the previous request
                    self._connection.set_default_sink(snapshot.default_sink)
                self._connection.set_default_sink(SINK)
            self._taken_s = now_s
