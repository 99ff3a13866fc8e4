"""Drop-in mode: applications play to a virtual sink, which the server forwards to a real sink.

The server can therefore delay the sound so that it matches the vibration. The sound continues even
if this process is killed.
"""

import threading
import time
from collections.abc import Callable
from contextlib import suppress

from device.errors import LostError, NotFoundError, UsageError
from device.server import forwarding
from device.server.forwarding import SINK, Loopback, Route, loopbacks, round_delay_ms
from device.server.identity import find_sink
from device.server.moved_streams import TAKES_S, DefaultSinkClaim, MovedStreams, is_unused
from device.server.pulse import PulseConnection
from device.server.snapshot import Listener, ServerSnapshot

_APPEARS_S = 1.5  # longest wait until a sink or loopback appears
_AGAIN_S = 1.0  # time between a refused request and its repetition
_CONTESTED = (
    "another program keeps choosing another default sink; there is no vibration for sound there "
    f"until {SINK!r} is the default sink again"
)


class DropIn(Listener):
    """Makes the virtual sink `cushion` the default and forwards it to a real sink, until `close`.

    The real sink is the target. If the user chooses another default sink, a thread makes it the
    target. While the target is missing, the sound goes to another sink. Any thread except the
    connection's may call the methods.
    connection: to the server. target: a sink's name; None selects the default sink. If a killed
    process left its virtual sink as the default, None keeps that process's target, without a gap in
    the sound. delay_s: time from capture at the virtual sink's monitor to playback by the target, 0
    to 0.5 s; at least 0.02 s is used. None keeps the delay of a killed process, or else selects
    0.02 s. haptic_sink: plays vibration and is never a target. target_name: name of the present
    target. reason: text about a problem, or "". LostError: the connection is lost; a later loss
    ends the thread without an error. NotFoundError: the target is missing or not allowed, or the
    server refuses a module.
    UsageError: delay_s is out of range, or the server's modules cannot handle the target's name.
    """

    def __init__(
        self,
        connection: PulseConnection,
        target: str | None = None,
        delay_s: float | None = None,
        *,
        haptic_sink: str | None = None,
    ) -> None:
        snapshot = connection.snapshot()
        left = next((one.route for one in reversed(loopbacks(snapshot)) if one.complete), None)
        self.target_name = self.reason = self._refusal = ""
        self._connection, self._haptic_sink = connection, haptic_sink
        if left and delay_s is None:
            delay_s = left.delay_ms / 1e3
        self._delay_ms = round_delay_ms(delay_s)
        self._targets: list[str] = []  # previous targets, the latest last
        self._target, self._restore = self._first_route(snapshot, target, left)
        self._circular: set[str] = set()  # sinks that play to the virtual sink
        self._default = DefaultSinkClaim(connection, snapshot.default_sink)
        self._streams = MovedStreams(connection)
        self._wake, self._stop = threading.Event(), threading.Event()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="drop-in", daemon=True)
        try:
            self._follow(snapshot)
        except (NotFoundError, UsageError):
            with suppress(LostError):
                self._restore_all()
            raise
        connection.add(self)
        self._thread.start()

    @property
    def delay_s(self) -> float:
        """The requested delay in s, at least 0.02. A thread applies a new value soon.

        A change repeats or drops a part of the sound, and may cause silence or doubled sound for a
        short time. UsageError: the value is out of range.
        """
        return self._delay_ms / 1e3

    @delay_s.setter
    def delay_s(self, delay_s: float) -> None:
        self._delay_ms = round_delay_ms(delay_s)
        self._wake.set()

    def spare(self, haptic_sink: str | None) -> None:
        """Change the haptic sink, which is never a target; None if there is none."""
        if haptic_sink != self._haptic_sink:
            self._haptic_sink = haptic_sink
            self._wake.set()

    def close(self) -> None:
        """Undo all changes on the sound server. May be repeated; raises nothing."""
        if self._closed:
            return
        self._closed = True
        self._stop.set()
        self._wake.set()
        self._connection.remove(self)
        self._thread.join()
        with suppress(LostError):
            self._restore_all()
        self.target_name = ""

    def on_snapshot(self, snapshot: ServerSnapshot) -> None:
        """Wake the thread."""
        if snapshot.default_sink == SINK:
            self._default.stable_name = SINK
        self._wake.set()

    def on_default_sink(self, name: str) -> None:
        """Store the name of a default sink that has persisted."""
        self._default.stable_name = name
        self._wake.set()

    def on_lost(self, error: LostError) -> None:
        """End the thread."""
        self._stop.set()
        self._wake.set()

    # ------------------------------------------------------------------------ on the own thread

    def _run(self) -> None:
        wait_s: float | None = 0.0
        while not self._stop.is_set():
            self._wake.wait(wait_s)
            self._wake.clear()
            try:
                settled = self._stop.is_set() or self._follow(self._connection.latest)
                wait_s = None if settled else TAKES_S
            except (NotFoundError, UsageError, LostError) as error:
                if self._connection.lost is not None:
                    return
                self.reason = str(error)  # the connection still works: only one answer was late
                wait_s = 0.0
                self._stop.wait(_AGAIN_S)

    def _follow(self, snapshot: ServerSnapshot) -> bool:
        """Change sinks, loopback and streams as needed; return False if a repetition is needed."""
        now_s = time.monotonic()
        self._streams.free_vibration(snapshot, self._haptic_sink)
        choice = self._default.detect_choice(snapshot, now_s, self._possible_targets(snapshot))
        if choice in self._possible_targets(snapshot):
            self._refusal = ""
            self._target = self._restore = choice
            self._circular.discard(choice)
            self._streams.forget()
        elif choice is not None:
            why = self._why_unfit(choice)
            self._refusal = f"the sound does not go to {choice!r}, the new default sink: {why}"
        target = self._choose_target(snapshot)
        snapshot = self._ensure_sink(snapshot, target)
        snapshot = self._ensure_loopback(snapshot, target)
        if target is None:
            self.reason = "no sink is left to forward the sound to; connect one"
            return True
        self._default.claim(snapshot, now_s)
        if not self._streams.break_loop(snapshot, target, self._possible_targets(snapshot)):
            self._circular.add(target)
            self._refusal = f"the sink {target!r} plays to {SINK!r} itself; choose another one"
            return False
        if not (contested := self._default.contested):
            self._streams.collect(snapshot, target, now_s)
        self.reason = _CONTESTED if contested else self._refusal
        return (contested or self._default.settled) and self._streams.all_here

    def _choose_target(self, snapshot: ServerSnapshot) -> str | None:
        """Return the sink to forward to: the chosen sink, else the latest target, else any sink."""
        fit = [name for name in self._possible_targets(snapshot) if name not in self._circular]
        return self._target if self._target in fit else next(iter(fit), None)

    def _possible_targets(self, snapshot: ServerSnapshot) -> list[str]:
        """Return the names of all possible targets: former targets, latest first, then others."""
        names = forwarding.real_sinks(snapshot, self._haptic_sink)
        before = [name for name in reversed(self._targets) if name in names]
        return [*before, *(name for name in names if name not in before)]

    def _ensure_sink(self, snapshot: ServerSnapshot, target: str | None) -> ServerSnapshot:
        if target is None or snapshot.sink(SINK) is not None:
            return snapshot
        arguments = forwarding.sink_arguments(snapshot, find_sink(snapshot, target))
        self._connection.load_module("module-null-sink", arguments)
        self._streams.forget()
        snapshot = self._await(lambda seen: seen.sink(SINK) is not None)
        if snapshot.sink(SINK) is None:
            raise NotFoundError(f"the sound server does not make the sink {SINK!r}; restart it")
        return snapshot

    def _ensure_loopback(self, snapshot: ServerSnapshot, target: str | None) -> ServerSnapshot:
        """Keep or make one loopback to the target, and unload all others."""
        found = loopbacks(snapshot)
        keep = None
        if target is not None:
            route = Route(target, self._restore, self._delay_ms)
            fitting = [one.module for one in found if one.complete and one.route == route]
            keep = fitting[-1] if fitting else self._load_loopback(snapshot, route, found)
            self._targets = [*(name for name in self._targets if name != target), target]
        self.target_name = target or ""
        for one in found:
            if one.module != keep:
                self._unload(one.module)
        return self._connection.latest

    def _load_loopback(self, snapshot: ServerSnapshot, route: Route, found: list[Loopback]) -> int:
        arguments = forwarding.loopback_arguments(snapshot, route, find_sink(snapshot, SINK))
        module = self._connection.load_module("module-loopback", arguments)
        sounds_s = time.monotonic() + route.delay_ms / 1e3

        def complete(seen: ServerSnapshot) -> bool:
            return any(one.module == module and one.complete for one in loopbacks(seen))

        if not complete(self._await(complete)):
            self._unload(module)
            raise NotFoundError(
                f"the sound server does not forward to the sink {route.target!r}; check that it "
                "can play sound, or choose another one"
            )
        if any(one.complete for one in found):
            time.sleep(max(0.0, sounds_s - time.monotonic()))
        return module

    def _restore_all(self) -> None:
        snapshot = self._connection.snapshot()
        back = self._restore if snapshot.sink(self._restore) else self._choose_target(snapshot)
        if back is not None:
            if snapshot.default_sink == SINK:
                with suppress(NotFoundError):
                    self._connection.set_default_sink(back)
            self._streams.restore(self._await(is_unused, TAKES_S), back)
            snapshot = self._await(is_unused, TAKES_S)
        for one in loopbacks(snapshot):
            self._unload(one.module)
        if (sink := snapshot.sink(SINK)) is not None and sink.module is not None:
            self._unload(sink.module)

    def _unload(self, module: int) -> None:
        with suppress(NotFoundError):
            self._connection.unload_module(module)

    def _await(
        self, condition: Callable[[ServerSnapshot], bool], limit_s: float = _APPEARS_S
    ) -> ServerSnapshot:
        """Return the first snapshot that meets the condition, or, after limit_s, the latest one."""
        until_s = time.monotonic() + limit_s
        while not condition(snapshot := self._connection.snapshot()):
            if time.monotonic() > until_s:
                break
            time.sleep(0.005)
        return snapshot

    def _first_route(
        self, snapshot: ServerSnapshot, target: str | None, left: Route | None
    ) -> tuple[str, str]:
        sink = snapshot.sink(SINK)
        if sink is not None and (sink.module is None or forwarding.MARK not in sink.properties):
            raise NotFoundError(f"there is a sink {SINK!r} that is not ours; rename or remove it")
        default = snapshot.default_sink
        names = self._possible_targets(snapshot)
        if target is not None:
            find_sink(snapshot, target)
        elif default != SINK:
            target = default
        elif left is not None and left.target in names:
            target = left.target
        else:
            target = next(iter(names), "")
        if target not in names:
            raise NotFoundError(
                f"sound cannot be forwarded to the sink {target!r}: {self._why_unfit(target)}; "
                "choose another default sink, or name a sink"
            )
        if default in ("", SINK):
            default = left.restore if left is not None else target
        return target, default

    def _why_unfit(self, name: str) -> str:
        if not name:
            return "there is no sink"
        return "the vibration goes there" if name == self._haptic_sink else "this program made it"
