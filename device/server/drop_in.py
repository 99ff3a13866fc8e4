"""Standing in between: applications play to a virtual sink, the server forwards it to the real one.

So the sound can be delayed to meet the vibration, and a tap on the virtual sink has all of it. The
server does the forwarding: the sound goes on if this process hangs, is killed or is started anew.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress

from device.errors import LostError, NotFoundError, UsageError
from device.server.forwarding import (
    SINK,
    Loopback,
    Route,
    is_cushion_sink,
    loopback_arguments,
    loopbacks,
    our_sink,
    real_sinks,
    round_delay_ms,
    sink_arguments,
)
from device.server.identity import find_sink
from device.server.moved_streams import TAKES_S, DefaultSink, Guests, none_here
from device.server.pulse import PulseConnection
from device.server.snapshot import Listener, ServerSnapshot

_APPEARS_S = 1.5
"""How long a sink or loopback may take from its loading until it is there; 20 ms is usual."""

_AGAIN_S = 1.0
"""How long to wait after the server has refused something."""

_CONTESTED = (
    "another program keeps making another sink the default one; what plays there is not felt "
    f"until {SINK!r} is made the default sink again"
)


class DropIn(Listener):
    """The virtual sink `cushion`, forwarded to a real sink and made the default, until `close`.

    target: name of the real sink; None for the default one, or the one that a killed process has
    forwarded to: what it left is taken over, without a gap. delay_s: from the virtual sink's
    monitor until the real sink plays it, 0 to 0.5 s; what is less than 0.02 s becomes that; None
    keeps a killed process's. haptic_sink: name of the sink for vibration, which is never a target.

    A thread of its own follows: another default sink chosen by the user becomes the target; where
    the target vanishes another one is forwarded to until it is back. Volume keys change the
    virtual sink, and with it the vibration: its monitor comes after the volume, on both servers.

    Any thread but the connection's may call the methods and read: sink_name; target_name, "" while
    there is none; reason: what a user should know, one line, "" if all is well.

    Raises
    ------
    LostError
        The connection is lost. Later on that ends the following without an error.
    NotFoundError
        There is no such target, the default sink is no target, or a module cannot be loaded.
    UsageError
        delay_s is out of range, or the target has a name that no module takes.
    """

    sink_name = SINK

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
        self.target_name = self.reason = ""
        self._refusal = ""
        self._connection = connection
        self._haptic_sink = haptic_sink
        self._delay_ms = round_delay_ms(
            left.delay_ms / 1e3 if left and delay_s is None else delay_s
        )
        self._target, self._restore = self._first_route(snapshot, target, left)
        self._targets: list[str] = []  # forwarded to so far, the latest last
        self._circular: set[str] = set()  # sinks that play to ours themselves
        self._default = DefaultSink(connection, snapshot.default_sink)
        self._guests = Guests(connection)
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="drop-in", daemon=True)
        try:
            self._follow(snapshot)
        except (NotFoundError, UsageError):
            with suppress(LostError):
                self._put_back()
            raise
        connection.add(self)
        self._thread.start()

    @property
    def delay_s(self) -> float:
        """The delay asked for, at least 0.02 s; may be set: it changes soon after.

        A new loopback takes over from the old one when its own delay has passed, so sound is
        repeated or left out by the difference, and silent or doubled for up to 20 ms; on PipeWire
        a delay of 0.15 s or more may be heard doubled for that long. UsageError: out of range.
        """
        return self._delay_ms / 1e3

    @delay_s.setter
    def delay_s(self, delay_s: float) -> None:
        self._delay_ms = round_delay_ms(delay_s)
        self._wake.set()

    @property
    def haptic_sink(self) -> str | None:
        """The name of the sink that is never a target; may be set."""
        return self._haptic_sink

    @haptic_sink.setter
    def haptic_sink(self, name: str | None) -> None:
        self._haptic_sink = name
        self._wake.set()

    @property
    def forwarded(self) -> bool:
        """Whether both streams of the loopback are where they belong, as far as is known."""
        found = () if self._connection.lost else loopbacks(self._connection.latest)
        return any(one.complete and one.route.target == self.target_name for one in found)

    def close(self) -> None:
        """Let the user's sound go on without us, all as it was before; again too, raises nothing.

        First the default sink and the streams go back, and only then the forwarding ends; what
        was delayed and not heard yet is left out.
        """
        if self._closed:
            return
        self._closed = True
        self._stop.set()
        self._wake.set()
        self._connection.remove(self)
        self._thread.join()
        with suppress(LostError):
            self._put_back()
        self.target_name = ""

    # ------------------------------------------------------------- called by the connection

    def on_snapshot(self, snapshot: ServerSnapshot) -> None:
        """Have a look at it soon."""
        self._wake.set()

    def on_default_sink(self, name: str) -> None:
        """Note that it is chosen for good."""
        self._default.told = name
        self._wake.set()

    def on_lost(self, error: LostError) -> None:
        """Follow no longer."""
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
            except (NotFoundError, UsageError) as error:
                self.reason = str(error)
                wait_s = 0.0
                self._stop.wait(_AGAIN_S)
            except LostError as error:
                if self._connection.lost is not None:
                    return
                self.reason = str(error)  # one answer came too late; the next one need not
                wait_s = 0.0
                self._stop.wait(_AGAIN_S)

    def _follow(self, snapshot: ServerSnapshot) -> bool:
        """Do what is to be done now; whether nothing is left to do until the next event."""
        now_s = time.monotonic()
        self._guests.free_vibration(snapshot, self._haptic_sink)
        choice = self._default.choice(snapshot, now_s, self._fit(snapshot))
        if choice is not None:
            self._obey(choice, snapshot)
        target = self._aim(snapshot)
        snapshot = self._keep_sink(snapshot, target)
        snapshot = self._keep_loopback(snapshot, target)
        if target is None:
            self.reason = "no sink is left to forward the sound to; connect one"
            return True
        self._default.take(snapshot, now_s)
        if not self._guests.break_loop(snapshot, target, self._fit(snapshot)):
            self._circular.add(target)
            self._refusal = f"the sink {target!r} plays to {SINK!r} itself; choose another one"
            return False
        if not self._default.contested:
            self._guests.bring(snapshot, target, now_s)
        self.reason = _CONTESTED if self._default.contested else self._refusal
        settled = self._default.settled or self._default.contested
        return settled and self._guests.all_here

    def _obey(self, choice: str, snapshot: ServerSnapshot) -> None:
        """Take another default sink for the user's wish to hear the sound there."""
        if choice in self._fit(snapshot):
            self._refusal = ""
            self._target = self._restore = choice
            self._circular.discard(choice)
            self._guests.forget()
        else:
            self._refusal = (
                f"the sound is not led to {choice!r}, which was made the default sink: "
                f"{self._unfit(choice)}"
            )

    def _aim(self, snapshot: ServerSnapshot) -> str | None:
        """The sink to forward to: the one wished for, else an earlier one, else any."""
        fit = [name for name in self._fit(snapshot) if name not in self._circular]
        return self._target if self._target in fit else next(iter(fit), None)

    def _fit(self, snapshot: ServerSnapshot) -> list[str]:
        """The sinks that may be forwarded to, those of before first."""
        names = real_sinks(snapshot, self._haptic_sink)
        before = [name for name in reversed(self._targets) if name in names]
        return [*before, *(name for name in names if name not in before)]

    def _keep_sink(self, snapshot: ServerSnapshot, target: str | None) -> ServerSnapshot:
        """See that there is the virtual sink."""
        if target is None or our_sink(snapshot) is not None:
            return snapshot
        arguments = sink_arguments(snapshot, find_sink(snapshot, target))
        self._connection.load_module("module-null-sink", arguments)
        self._guests.forget()
        snapshot = self._await(lambda seen: our_sink(seen) is not None)
        if our_sink(snapshot) is None:
            raise NotFoundError(f"the sound server does not make the sink {SINK!r}; restart it")
        return snapshot

    def _keep_loopback(self, snapshot: ServerSnapshot, target: str | None) -> ServerSnapshot:
        """See that a loopback leads to the target, and no other one anywhere."""
        found = loopbacks(snapshot)
        keep = None
        if target is not None:
            route = Route(target, self._restore, self._delay_ms)
            fitting = [one.module for one in found if one.complete and one.route == route]
            keep = fitting[-1] if fitting else self._load(snapshot, route, found)
            self._targets = [*(name for name in self._targets if name != target), target]
        self.target_name = target or ""
        for one in found:
            if one.module != keep:
                with suppress(NotFoundError):
                    self._connection.unload_module(one.module)
        return self._connection.latest

    def _load(self, snapshot: ServerSnapshot, route: Route, found: list[Loopback]) -> int:
        """A new loopback on this route, once the sound comes out of it."""
        arguments = loopback_arguments(snapshot, route, find_sink(snapshot, SINK))
        module = self._connection.load_module("module-loopback", arguments)
        sounds_s = time.monotonic() + route.delay_ms / 1e3

        def complete(seen: ServerSnapshot) -> bool:
            return any(one.module == module and one.complete for one in loopbacks(seen))

        if not complete(self._await(complete)):
            with suppress(NotFoundError):
                self._connection.unload_module(module)
            raise NotFoundError(
                f"the sound server does not forward to the sink {route.target!r}; see whether "
                "sound can be played there, or choose another one"
            )
        if any(one.complete for one in found):
            time.sleep(max(0.0, sounds_s - time.monotonic()))
        return module

    def _put_back(self) -> None:
        snapshot = self._connection.snapshot()
        names = [sink.name for sink in snapshot.sinks]
        back = self._restore if self._restore in names else self._aim(snapshot)
        if back is not None:
            if snapshot.default_sink == SINK:
                with suppress(NotFoundError):
                    self._connection.set_default_sink(back)
            snapshot = self._await(none_here, TAKES_S)
            self._guests.put_back(snapshot, back)
            snapshot = self._await(none_here, TAKES_S)
        sink = our_sink(snapshot)
        modules = [one.module for one in loopbacks(snapshot)]
        if sink is not None and sink.module is not None:
            modules.append(sink.module)
        for module in modules:
            with suppress(NotFoundError):
                self._connection.unload_module(module)

    # ---------------------------------------------------------------------------------- inside

    def _await(
        self, condition: Callable[[ServerSnapshot], bool], limit_s: float = _APPEARS_S
    ) -> ServerSnapshot:
        """The first snapshot of which the condition holds, else the last one within the limit."""
        until_s = time.monotonic() + limit_s
        while not condition(snapshot := self._connection.snapshot()):
            if time.monotonic() > until_s:
                break
            time.sleep(0.005)
        return snapshot

    def _first_route(
        self, snapshot: ServerSnapshot, target: str | None, left: Route | None
    ) -> tuple[str, str]:
        """The target and the default sink to restore."""
        sink = our_sink(snapshot)
        if sink is not None and not is_cushion_sink(sink):
            raise NotFoundError(f"there is a sink {SINK!r} that is not ours; rename or remove it")
        default = snapshot.default_sink
        names = real_sinks(snapshot, self._haptic_sink)
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
                f"sound cannot be forwarded to the sink {target!r}: {self._unfit(target)}; choose "
                "another default sink, or name a sink"
            )
        if default not in ("", SINK):
            return target, default
        return target, left.restore if left is not None else target

    def _unfit(self, name: str) -> str:
        if not name:
            return "there is none"
        return "the vibration goes there" if name == self._haptic_sink else "it is one of ours"
