"""Applications' streams in drop-in mode, the guests: brought to the virtual sink, and back again.

Most follow the default sink by themselves, both ways, and stay free to follow it later. Only those
that are bound to the real sink are moved. One thread at a time calls the methods; times are seconds
of time.monotonic(). LostError: the server is gone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from contextlib import suppress

from device.errors import NotFoundError
from device.server.forwarding import (
    SINK,
    carries_sound_of,
    is_application,
    our_sink,
    reachable_sinks,
)
from device.server.identity import find_sink
from device.server.pulse import PulseConnection
from device.server.snapshot import ServerSnapshot, Stream
from device.stream.pcms import ROLE


def none_here(snapshot: ServerSnapshot) -> bool:
    """Whether nothing plays to the virtual sink."""
    return not any(stream.device_name == SINK for stream in snapshot.sink_inputs)


class Guests:
    """The streams that are to play to the virtual sink. all_here: whether none was to be moved."""

    def __init__(self, connection: PulseConnection) -> None:
        self.all_here = True
        self._connection = connection
        self._seen: set[int] = set()  # have played to the virtual sink
        self._astray: dict[int, float] = {}  # play past it, since when
        self._places: dict[int, str] = {}  # where streams were last, but for the virtual sink
        self._homes: dict[int, str] = {}  # the sinks that those were on which had to be moved

    def forget(self) -> None:
        """Treat all streams as new ones: the target was changed or the sink made anew."""
        self._seen.clear()
        self._homes.clear()

    def free_vibration(self, snapshot: ServerSnapshot, haptic_sink: str | None) -> None:
        """Move vibration back to its sink.

        PulseAudio moves it along when the default sink was the haptic one and becomes ours.
        """
        for stream in snapshot.sink_inputs:
            if stream.device_name == SINK and stream.role == ROLE and haptic_sink is not None:
                self._move(snapshot, stream, haptic_sink)

    def bring(self, snapshot: ServerSnapshot, target: str, now_s: float) -> None:
        """Move what plays on the target and has not followed the default sink.

        A stream that has played to the virtual sink and was then moved away is left where it is:
        somebody wants it so. What carries the target's own sound is left, too.
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
                since_s = astray[stream.index] = self._astray.get(stream.index, now_s)
                if now_s - since_s >= TAKES_S:
                    self._homes[stream.index] = target
                    self._move(snapshot, stream, SINK)
        self._astray = astray
        self.all_here = not astray

    def break_loop(self, snapshot: ServerSnapshot, target: str, others: Sequence[str]) -> bool:
        """Lead away what brings the target's sound to the virtual sink; whether that succeeded.

        These are streams of other virtual sinks, and loopbacks, that follow the default sink. They
        go where they were, or else to the first of `others` that the sound does not come to.
        """
        loop = reachable_sinks(snapshot, target)
        free = [name for name in others if name not in loop]
        places: dict[int, str] = {}
        broken = True
        for stream in snapshot.sink_inputs:
            place = stream.device_name
            if place == SINK and carries_sound_of(snapshot, stream, loop):
                before = self._places.get(stream.index, "")
                wishes = free if before in ("", *loop) else [before, *free]
                broken = any(self._move(snapshot, stream, wish) for wish in wishes) and broken
            places[stream.index] = self._places.get(stream.index, "") if place == SINK else place
        self._places = places
        return broken

    def put_back(self, snapshot: ServerSnapshot, default: str) -> None:
        """Move streams to where they were, others than followed to the default sink to that."""
        for stream in snapshot.sink_inputs:
            home = default if stream.device_name == SINK else stream.device_name
            home = self._homes.get(stream.index, home)
            if stream.device_name != home and is_application(stream):
                self._move(snapshot, stream, home)

    def _move(self, snapshot: ServerSnapshot, stream: Stream, sink_name: str) -> bool:
        """Whether the server has moved it."""
        with suppress(NotFoundError):  # it has ended, must not be moved, or there is no such sink
            self._connection.move_sink_input(stream.index, find_sink(snapshot, sink_name).index)
            return True
        return False


TAKES_S = 0.3
"""Servers and session managers have followed a new default sink by then; 50 ms are usual."""

_CONTESTS, _CONTEST_S = 5, 10.0
"""Who chooses other default sinks so often in so short a time is no user but a program."""


class DefaultSink:
    """Makes the virtual sink the default one and tells what was chosen instead.

    told: the default sink that has stayed the same for a while, as `Listener.on_default_sink` has
    it; any thread may set it. settled: whether the default sink is ours, and nothing is to be
    done. contested: another program wants it for itself, so that it was left alone.
    """

    def __init__(self, connection: PulseConnection, told: str) -> None:
        self.told = told
        self.settled = False
        self.contested = False
        self._connection = connection
        self._taken_s: float | None = None
        self._choices: deque[float] = deque(maxlen=_CONTESTS)

    def choice(self, snapshot: ServerSnapshot, now_s: float, fit: Collection[str]) -> str | None:
        """The sink that was made the default one since it was ours: told once.

        fit: what may be chosen; that has to stay chosen for a while, others are told at once.
        """
        default = snapshot.default_sink
        if default == SINK:
            self.settled, self.contested = True, False
        elif our_sink(snapshot) is None:
            self.settled = False  # the server chose another one, since ours is gone
        elif self.settled and default and (default == self.told or default not in fit):
            self.settled = False
            self._choices.append(now_s)
            often = len(self._choices) == _CONTESTS and now_s - self._choices[0] < _CONTEST_S
            self.contested = often
            return default
        return None

    def take(self, snapshot: ServerSnapshot, now_s: float) -> None:
        """Make the virtual sink the default one; again and again until it is.

        WirePlumber may not accept a sink that was only just made. LostError: the server is gone.
        """
        if self.settled or self.contested or snapshot.default_sink == SINK:
            return
        if self._taken_s is None or now_s - self._taken_s >= TAKES_S:
            self._taken_s = now_s
            with suppress(NotFoundError):
                self._connection.set_default_sink(SINK)
