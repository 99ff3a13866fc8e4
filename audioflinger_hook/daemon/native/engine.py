"""The native engine: keeps the plugin running, and links it between tap and device."""

import math
import os
from collections.abc import Callable
from pathlib import Path

from audioflinger_hook.daemon.inputs.applications import Applications
from audioflinger_hook.daemon.native import taps
from audioflinger_hook.daemon.native.chain import NAME, Chain
from audioflinger_hook.daemon.native.chains import FADE_S, Chains, Restore, RunningChain
from audioflinger_hook.daemon.native.plan import ChainPlan, DriveDesigns
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.service.state import Cause, StateKeeper
from device.drive.channel_positions import actuators_of_channels
from device.errors import LostError, NotFoundError, UsageError
from device.server.graph_watch import GraphWatch
from device.server.node_errors import NodeErrors
from device.server.snapshot import Sink, Source

REFUSED_S = 0.5  # a link that is missing for this time counts as refused

# A missing link may merely be late, so links from streams are tried again after growing waits.
REFUSED_WAIT_S, REFUSED_WAIT_MAX_S = 5.0, 600.0


class NativeEngine:
    """Runs one chain, and a second chain during a change of settings.

    The supervising thread calls the methods. Any thread may read the attributes.

    folder, on_change, restore: see `NativeRun`. errors: xruns of the chains' nodes.
    monitor_reason: why the sink's monitor is tapped instead of the streams, or "".
    audible: whether a linked chain plays. is_fed: whether a tapped stream plays.
    waits_for: why the engine cannot play yet, or "". NotFoundError: a PipeWire program is missing.
    """

    def __init__(
        self,
        config: RunConfig,
        folder: Path,
        states: StateKeeper,
        on_change: Callable[[], None],
        restore: Restore,
        designs: DriveDesigns,
        monitor_reason: str = "",
    ) -> None:
        self._config, self._states = config, states
        self.watch = GraphWatch(on_change)
        self.errors = NodeErrors()
        self.chains = Chains(config, folder, restore, designs)
        self.designs = designs
        self._tap: taps.Tap | None = None
        self._wiring = taps.ChainWiring()
        self._has_played = False
        self._faded_s = math.inf
        self.monitor_reason, self._must_use_monitor = monitor_reason, bool(monitor_reason)
        self._refused_until_s, self._refused_wait_s = -math.inf, REFUSED_WAIT_S
        self._session_manager: int | None = None
        self.waits_for = ""
        self.audible = self.is_fed = False

    @property
    def chain(self) -> Chain | None:
        """The current chain, or None."""
        current = self.chains.current  # another thread may change `current`
        return current.chain if current else None

    @property
    def is_steady(self) -> bool:
        """Whether a chain plays, and neither changes nor is being replaced."""
        chains, chain = self.chains, self.chain
        changes = chain is None or chain.is_changing
        return self.audible and not changes and chains.following is None and not chains.leaving

    @property
    def plays_trials(self) -> bool:
        """Whether a program plays trials, which replace the tap."""
        with self.watch.lock:
            return self.watch.graph.sink(taps.TRIALS) is not None

    def unseen(self, tap: taps.Tap, device: Sink) -> str:
        """Return why tap or device cannot be linked, "" if both can be linked."""
        with self.watch.lock:
            return taps.why_unlinkable(self.watch.graph, tap, device.name)

    def follow(self, config: RunConfig) -> None:
        """Apply another config. The next `maintain` starts a new chain if necessary."""
        self._config = config
        self.chains.follow(config)

    def use_monitor(self, reason: str) -> None:
        """Tap the sink's monitor from now on; without a reason, the streams."""
        self._must_use_monitor, self.monitor_reason = bool(reason), reason

    def maintain(self, found: Source | Applications, device: Sink, now_s: float) -> bool:
        """Start, link and check the chain; return whether the chain plays.

        LostError: a chain or the connection was lost; call it again. NotFoundError: streams cannot
        be linked. UsageError: missing channel or unknown rig. For other errors, see `Chain`.
        """
        self._faded_s = math.inf
        tap = taps.tap_of(found, self._config.rules, self._config.left_out)
        before, self._tap = self._tap, tap
        if before != tap:
            if not self._must_use_monitor:
                self.monitor_reason = ""
            is_moved = before and before.sink and tap.sink and before.sink != tap.sink
            if is_moved and self._config.tap.kind == "default":
                self._states.count(Cause.DEFAULT_CHANGED, f"the tap is now: {tap.name}")
        if self.plays_trials:
            tap = taps.Tap("trials", (taps.FELT,) * tap.channels, taps.TRIALS, is_trial=True)
        if self.watch.lost:
            raise LostError("the connection to PipeWire's graph was lost")
        with self.watch.lock:
            graph, chains = self.watch.graph, self.chains
            chains.end_leaving(graph, now_s)
            if not self._has_session(now_s):
                self.designs.end()
                return False
            try:
                chains.check(graph, now_s, is_fed=self.is_fed)
            except LostError:
                self.audible = self.audible and chains.current is not None
                raise
            chains.make(ChainPlan.of(self._config.settings, tap, chains.samplerate(graph)), now_s)
            self._wire(tap, device, now_s)
            self._note_links(now_s)
            if not tap.is_trial:
                self._choose_way(now_s)
        chains.adopt(now_s)
        self.audible = chains.let_play(now_s)
        self._has_played |= self.audible
        if chains.current is not None:
            chains.current.look_for_priority(now_s)
        names = [name for chain in self._wiring.chains for name in (chain.tap, chain.vibration)]
        self.errors.update(names if self.is_fed else (), now_s)
        return self.audible

    def lose_links(self, now_s: float) -> bool:
        """Remove all links because tap or device is missing.

        Return whether the engine has played since the previous call.
        """
        played, self._has_played = self._has_played, False
        self.chains.silence()
        self.designs.end()
        for running in self.chains.running:
            running.linked_s = math.inf
        self.audible = False
        with self.watch.lock:
            self._has_session(now_s)
            self.chains.end_leaving(self.watch.graph, now_s)
            self._wire(None, None, now_s)
        return played

    def fade_out(self, now_s: float) -> bool:
        """Fade the vibration out; return whether the fade has ended. Repeat the call until then."""
        self.audible = False
        self._faded_s = min(self._faded_s, now_s)
        return self.chains.silence() or now_s - self._faded_s > FADE_S

    def leave(self, now_s: float) -> bool:
        """Remove the chains' links; return whether all are gone. Repeat the call until then."""
        chains, graph = self.chains, self.watch.graph
        chains.leaving += chains.running
        chains.current = chains.following = None
        with self.watch.lock:
            self._wire(None, None, now_s)
            have_left = [one.has_left(graph, now_s) for one in chains.leaving]
        return all(have_left)

    def close(self) -> None:
        """End all chains and disconnect from the graph. Repeated calls do nothing."""
        self.chains.close()
        self.audible = False
        self.errors.close()
        self.watch.close()

    def _has_session(self, now_s: float) -> bool:
        """Return whether the session manager runs; end all chains after its end or restart.

        A restarted WirePlumber 0.4 would wait for nodes of earlier chains, and link no program.
        """
        known, seen = self._session_manager, self.watch.graph.session_manager
        if known is not None and seen != known and not self.waits_for:
            self._states.count(Cause.SERVER_LOST, "PipeWire's session manager has ended")
            self.chains.close()
            self._wire(None, None, now_s)
            self.audible = self.is_fed = False
        self._session_manager = seen if seen is not None else known
        gone = known is not None and seen is None
        self.waits_for = "PipeWire's session manager (WirePlumber) does not run" if gone else ""
        return not gone

    def _wire(self, tap: taps.Tap | None, device: Sink | None, now_s: float) -> None:
        """Link the chains to tap and device; without a device, remove all links."""
        ends = [one.chain.ends() for one in self.chains.leaving]
        ends += [self._ends(running, tap, device) for running in self.chains.running]
        self._wiring = taps.ChainWiring(
            chains=tuple(ends),
            tap=tap,
            device=device.name if device else "",
            device_positions=taps.port_names(device.channel_map, device.channels) if device else (),
            by_monitor=bool(self.monitor_reason or (tap and tap.is_trial)),
            silence=f"{NAME}-{os.getpid()}-silence",
        )
        self.watch.keeper.wiring = self._wiring
        self.watch.keeper.update(now_s)
        self.is_fed = self._wiring.is_fed(self.watch.graph)

    def _ends(
        self, running: RunningChain, tap: taps.Tap | None, device: Sink | None
    ) -> taps.ChainEnds:
        plan = running.chain.plan
        if tap is None or device is None or plan.tap_channels != tap.channels:
            return running.chain.ends()
        try:
            actuators = self._config.settings.actuators
            played = actuators_of_channels(device, actuators, plan.outputs).sources
        except UsageError:
            if running is self.chains.following or self.chains.following is None:
                raise
            return running.chain.ends()
        return running.chain.ends(played, linked=True)

    def _note_links(self, now_s: float) -> None:
        """For each chain, store the time since which all its necessary links exist."""
        graph, keeper = self.watch.graph, self.watch.keeper
        ends = {chain.tap: chain for chain in self._wiring.chains}
        for running in self.chains.running:
            chain = ends[running.chain.tap]
            on_device = self._wiring.device_links(graph, chain) if chain.linked else set()
            wanted = on_device
            if len(wanted) < sum(actuator is not None for actuator in chain.played):
                wanted = set()  # some ports of the device do not exist yet
            if self._wiring.by_monitor and chain.linked:
                from_tap = self._wiring.tap_links(graph, chain)
                wanted = wanted | from_tap if from_tap else set()
            elif wanted and not running.is_linked:
                first = self._wiring.silent_links(graph, chain)
                first |= self._wiring.tap_links(graph, chain)
                if keeper.missing_for_s(first, now_s) <= REFUSED_S:
                    wanted = wanted | first
            missing = keeper.missing(wanted)
            is_late = keeper.missing_for_s(missing, now_s) > REFUSED_S
            if running.is_linked and missing < on_device and not is_late:
                missing = set()  # a further channel of the device; the others play on
            exist = bool(wanted and chain.tap_ports(graph)) and not missing
            if exist and not running.is_linked:
                self.chains.backoff.succeeded()
            running.note_links(now_s, exist=exist)

    def _choose_way(self, now_s: float) -> None:
        """Tap the monitor if links from streams are refused; try links from streams again later.

        NotFoundError: links are refused, and a monitor cannot replace the selected streams.
        """
        tap, graph = self._wiring.tap, self.watch.graph
        assert tap is not None
        if self.monitor_reason:
            may_try = not self._must_use_monitor and now_s > self._refused_until_s
            if may_try and not any(tap.tapped_links(graph, self._wiring.device)):
                self.monitor_reason = ""
            return
        chains = [chain for chain in self._wiring.chains if chain.linked]
        wanted = {link for chain in chains for link in self._wiring.tap_links(graph, chain)}
        if self.watch.keeper.missing_for_s(wanted, now_s) <= REFUSED_S:
            return
        refused = "PipeWire does not make the links from the streams that play"
        if not tap.has_monitor:
            raise NotFoundError(f"{refused}, so applications cannot be chosen")
        self._refused_until_s = now_s + self._refused_wait_s
        self._refused_wait_s = min(2.0 * self._refused_wait_s, REFUSED_WAIT_MAX_S)
        self.monitor_reason = refused
