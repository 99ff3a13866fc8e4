"""The native engine: keeps a chain of the plugin running and linked from the tap to the device.

Only this engine links the chain. When the tap or the device vanishes, the links vanish with it, and
the vibration goes nowhere until both are back.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.inputs.applications import Applications
from audioflinger_hook.daemon.native.chain import NAME, Chain
from audioflinger_hook.daemon.native.page import Page, TransformReadings
from audioflinger_hook.daemon.native.plan import ChainPlan, device_map, device_ports
from audioflinger_hook.daemon.native.running import RunningChain
from audioflinger_hook.daemon.native.taps import Tap, tap_of
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.timing import Backoff
from audioflinger_hook.service.meters import Level
from audioflinger_hook.service.state import Cause, StateKeeper
from device.drive import ActuatorSettings
from device.drive.rig_processor import damping_for
from device.errors import LostError, UsageError
from device.rig import rig_by_name
from device.server.graph import Graph, Link
from device.server.paused_links import PausedLinks
from device.server.snapshot import Sink, Source
from device.units import db_to_amplitude

FADE_S = 0.4
"""Longest wait for a chain to fade out. Its fade takes 40 ms; a graph that stands still, longer."""

STUCK_S = 5.0
"""A chain that processes nothing for so long although applications play is started again."""

START_S = 5.0
"""Longest time from the start of a process to its ports."""

LONGEST_WAIT_S = 1.0
"""Longest time between two starts."""


class NativeEngine:
    """The chain that plays, and the next one while it settles.

    The supervising thread calls the methods; any thread may read the attributes.

    folder: private, for files. states: counts what was lost and came back. on_change: called by
    another thread when the graph changes. audible: whether the chain is linked and plays.
    NotFoundError: a program of PipeWire is missing.
    """

    def __init__(
        self, config: RunConfig, folder: Path, states: StateKeeper, on_change: Callable[[], None]
    ) -> None:
        self._config = config
        self._folder = folder
        self._states = states
        self._graph = Graph(on_change)
        self._paused_links = PausedLinks()
        self._current: RunningChain | None = None
        self._next: RunningChain | None = None
        self._leaving: list[RunningChain] = []
        self._backoff = Backoff(longest_s=LONGEST_WAIT_S)
        self._tap: Tap | None = None
        self._has_played = False
        self._faded_s = math.inf
        self._sound_gain = 1.0
        self.audible = False
        for left_over in folder.glob(f"{NAME}-*"):  # of a daemon that was killed
            left_over.unlink(missing_ok=True)

    @property
    def plan(self) -> ChainPlan | None:
        """What the chain does, None before the first one."""
        current = self._current  # another thread may ask
        return current.chain.plan if current else None

    @property
    def process_id(self) -> int:
        """Number of the chain's process, 0 for none."""
        current = self._current
        return current.chain.process_id if current else 0

    @property
    def is_steady(self) -> bool:
        """Whether it plays, and no other chain is about to."""
        return self.audible and self._next is None and not self._leaving

    @property
    def is_lost(self) -> bool:
        """Whether the graph is gone, so that another engine must be made."""
        return self._graph.lost

    def unseen(self, found: Source | Applications, device: Sink) -> str:
        """Return the name of a node that the graph does not show, "" if it shows both."""
        if not self._graph.ports:
            return ""
        node = tap_of(found, ()).node
        if node and not self._graph.ports_of(node, "monitor_"):
            return node
        return "" if self._graph.ports_of(device.name, "playback_") else device.name

    def readings(self) -> TransformReadings | None:
        """Return what the transform reports, None before the first chain."""
        current = self._current
        return current.chain.page.readings() if current else None

    @property
    def page(self) -> Page | None:
        """The page of the chain that plays, None before the first one."""
        current = self._current
        return current.chain.page if current else None

    def level(self, slot: int) -> Level:
        """Return the level of an actuator."""
        current = self._current
        return current.chain.page.level(slot) if current else Level()

    def follow(self, config: RunConfig) -> None:
        """Use another config; what the plugin cannot change itself needs a new chain."""
        self._config = config
        for running in filter(None, (self._current, self._next)):
            self._set_actuators(running.chain)

    def set_sound_gain(self, gain: float) -> None:
        """Set the factor on the tap's sound."""
        self._sound_gain = gain
        for running in filter(None, (self._current, self._next)):
            running.chain.page.set_sound_gain(gain)

    def maintain(
        self,
        found: Source | Applications,
        device: Sink,
        players: frozenset[int],
        now_s: float,
        *,
        linked: bool,
    ) -> bool:
        """Start, link and check the chain; return whether it plays, or could if it were linked.

        players: streams that play into the tap. linked: whether it may be linked. Links join the
        graph's groups, which costs other streams of these devices some samples.
        LostError: the chain or the graph is gone; the next call starts again.
        UsageError: the device lacks a channel.
        """
        self._faded_s = math.inf
        self._end_leaving(now_s)
        tap = tap_of(found, self._graph.ports)
        self._note_moves(tap)
        if self._graph.lost:
            raise LostError("the connection to PipeWire's graph was lost")
        self._check(players, now_s)
        plan = ChainPlan.of(self._config.settings, tap)
        if self._current is None or self._current.chain.plan != plan:
            self._begin_next(plan, now_s)
        if not linked:
            waiting = self._current or self._next
            return waiting is not None and waiting.chain.is_in(self._graph)
        self._link(tap, device, now_s)
        self._adopt_next(now_s)
        self._let_play(now_s)
        return self.audible

    def mend_links(self, events: int, now_s: float) -> None:
        """Make links again that the server has left paused; events: of the server until now."""
        if self._current is not None:
            nodes = (self._current.chain.tap, self._current.chain.vibration)
            self._graph.remove(self._paused_links.look(events, nodes, now_s), now_s)

    def lose_links(self, now_s: float) -> bool:
        """Remove all links, as tap or device is away; return whether the engine had played."""
        played, self._has_played = self._has_played, False
        self._end_leaving(now_s)
        for running in filter(None, (self._current, self._next)):
            running.chain.page.set_audible(False)
            self._graph.ensure((), (running.chain.tap, running.chain.vibration), now_s)
        self.audible = False
        for running in filter(None, (self._current, self._next)):
            running.linked_s = math.inf
        return played

    def fade_out(self, now_s: float) -> bool:
        """Let the vibration end softly; return whether it has ended. Repeat it until then."""
        chains = [running for running in (self._current, self._next) if running]
        for running in chains:
            running.chain.page.set_audible(False)
        self.audible = False
        self._faded_s = min(self._faded_s, now_s)
        return all(one.is_silent for one in chains) or now_s - self._faded_s > FADE_S

    def fade_in(self) -> None:
        """Let the vibration begin again after `fade_out`."""
        self._faded_s = math.inf
        if self._current is not None and self._current.linked_s < math.inf:
            self._current.chain.page.set_audible(True)
            self.audible = True

    def leave(self, now_s: float) -> bool:
        """Take the chains out of the graph; return whether they are out. Repeat it until then.

        Only after `fade_out`.
        """
        self._leaving += filter(None, (self._current, self._next))
        self._current = self._next = None
        still_in = [one for one in self._leaving if not one.has_left(self._graph, now_s)]
        return not still_in

    def close(self) -> None:
        """End everything. May be repeated; raises nothing."""
        for running in (*filter(None, (self._current, self._next)), *self._leaving):
            running.chain.close()
        self._current = self._next = None
        self._leaving.clear()
        self.audible = False
        self._graph.close()

    def _note_moves(self, tap: Tap) -> None:
        before, self._tap = self._tap, tap
        if before is not None and not (before.node and tap.node):  # applications have no node
            return
        if before is not None and before.node != tap.node and self._config.tap.kind == "default":
            self._states.count(Cause.DEFAULT_CHANGED, f"the tap is now: {tap.name}")

    def _check(self, players: frozenset[int], now_s: float) -> None:
        """Drop chains that have ended or hang; raise LostError for the playing one."""
        for running in (self._next, self._current):
            if running is None:
                continue
            try:
                running.chain.check()
                if running.chain.is_stopped:
                    raise LostError("the native engine's process was stopped")
                if running.linked_s == math.inf and now_s - running.began_s > START_S:
                    graph_has_it = running.chain.is_in(self._graph)
                    if not graph_has_it:
                        raise LostError("the native engine did not appear in PipeWire's graph")
                frames = running.chain.page.frames
                if frames != running.frames or not players or running.linked_s == math.inf:
                    running.frames, running.moved_s = frames, now_s
                elif now_s - running.moved_s > STUCK_S:
                    raise LostError("the native engine processes nothing")
            except LostError:
                self._backoff.failed(now_s)
                running.chain.close()
                if running is self._next:
                    self._next = None
                else:
                    self._current = None
                    self.audible = False
                raise

    def _begin_next(self, plan: ChainPlan, now_s: float) -> None:
        if self._next is not None and self._next.chain.plan == plan:
            return
        if self._next is not None:
            self._next.chain.close()
            self._next = None
        if self._backoff.wait_s(now_s) > 0.0:
            return
        chain = Chain(plan, self._folder, realtime=self._config.live.realtime)
        self._next = RunningChain(chain, now_s, moved_s=now_s)
        chain.page.set_sound_gain(self._sound_gain)
        self._set_damping(chain)
        self._set_actuators(chain)

    def _link(self, tap: Tap, device: Sink, now_s: float) -> None:
        wanted: set[Link] = set()
        nodes: list[str] = []
        for running in filter(None, (self._current, self._next)):
            chain = running.chain
            nodes += [chain.tap, chain.vibration]
            if not chain.is_in(self._graph) or chain.plan.tap_channels != tap.channels:
                continue
            try:
                played = device_map(self._config.settings, chain.plan, device).sources
            except UsageError:
                if running is self._next or self._next is None:
                    raise
                continue
            wanted |= chain.links(tap.ports, device_ports(device), played)
        self._graph.ensure(wanted, nodes, now_s)
        for running in filter(None, (self._current, self._next)):
            own = {link for link in wanted if running.chain.name in f"{link[0]} {link[1]}"}
            linked = bool(own) and own <= self._graph.links
            if linked and running.linked_s == math.inf:
                running.linked_s = running.moved_s = now_s
                self._backoff.succeeded()
            elif not linked:
                running.linked_s = math.inf

    def _end_leaving(self, now_s: float) -> None:
        for running in tuple(self._leaving):
            if running.has_left(self._graph, now_s):
                self._leaving.remove(running)
                running.chain.close()

    def _adopt_next(self, now_s: float) -> None:
        """Let the next chain take the place of one that has faded out."""
        old, new = self._current, self._next
        if new is None or new.linked_s == math.inf:
            return
        if old is None:
            self._current, self._next = new, None
        elif new.is_settled(now_s) and (old.is_silent or now_s - old.moved_s >= FADE_S):
            self._leaving.append(old)
            self._current, self._next = new, None

    def _let_play(self, now_s: float) -> None:
        """Fade the chains in or out: the next one takes over when it has settled."""
        takes_over = self._next is not None and self._next.is_settled(now_s)
        self.audible = False
        for running in filter(None, (self._current, self._next)):
            chosen = self._next if takes_over else self._current
            plays = running is chosen and running.linked_s < math.inf
            running.chain.page.set_audible(plays)
            self.audible |= plays
        self._has_played |= self.audible

    def _set_actuators(self, chain: Chain) -> None:
        settings, offset_s = self._config.settings, max(0.0, self._config.live.offset_s)
        level = 0.0 if self._config.muted else db_to_amplitude(settings.gain_db)
        if not settings.actuators:
            for slot in range(len(chain.plan.actuators)):
                chain.page.set_actuator(slot, level, offset_s)
        for slot, actuator in enumerate(settings.actuators[: len(chain.plan.actuators)]):
            delay_s = offset_s + 1e-3 * actuator.delay_ms
            chain.page.set_actuator(slot, level * actuator.factor, delay_s)

    def _set_damping(self, chain: Chain) -> None:
        settings = self._config.settings
        actuators: tuple[ActuatorSettings | Settings, ...] = settings.actuators or (settings,)
        for slot in range(len(chain.plan.actuators)):
            one = actuators[min(slot, len(actuators) - 1)]
            if (one.damping or settings.damping) == "off":
                continue
            rig = rig_by_name(one.rig or settings.rig)
            damping = damping_for(rig.actuator, rig.amplifier.source_impedance_ohm)
            chain.page.set_damping(slot, damping, chain.plan.samplerate)
