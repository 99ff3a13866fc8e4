"""Starts, replaces and ends chains; a chain is a process with the plugin in PipeWire's graph."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from audioflinger_hook.daemon.native.chain import NAME, Chain, ChainDesign, has_realtime
from audioflinger_hook.daemon.native.plan import ChainPlan, DriveDesigns
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.timing import Backoff
from audioflinger_hook.drive.drive import DrivenRig
from device.drive.design import DriveDesign
from device.errors import LostError
from device.server.graph import Graph
from device.units import db_to_amplitude

FADE_S = 0.4  # longest wait for a fade, which never ends while the graph is idle
STUCK_S = 1.0  # time without progress, after which a chain is replaced if a stream plays
START_S = 5.0  # longest time from the start of a process until its ports exist
RESTART_S = 1.5  # age at which a process is restarted once; PipeWire 0.3 stalls 2 % of clients
SETTLED_FRAMES = 9_600  # number of frames that a new chain processes before it plays
SETTLED_S = 0.3  # longest wait for these frames, in case nothing plays
PRIORITY_S = 1.0  # time from linking a chain until the priority of its process is checked
LEAVE_S = 0.5  # longest wait for a chain's links to vanish before its process ends

# Sets the initial state of rigs. The second argument is True in the first call for these rigs.
Restore = Callable[[Sequence[DrivenRig | None], bool], None]


@dataclass
class RunningChain:
    """A chain and its times in seconds.

    began_s: start of the process. linked_s: time since which all links exist. frames: number of
    processed frames. moved_s: latest time when `frames` changed or was not expected to change.
    left_s: time of the first call of `has_left`. has_realtime: None before the check.
    has_settled: whether `is_settled` was ever true.
    """

    chain: Chain
    began_s: float
    linked_s: float = math.inf
    frames: int = 0
    moved_s: float = 0.0
    left_s: float = math.inf
    has_realtime: bool | None = None
    has_settled: bool = False
    _linked_frames: int = 0

    @property
    def is_silent(self) -> bool:
        """Whether the chain has faded out."""
        return self.chain.page.faded_out(len(self.chain.plan.actuators))

    def look_for_priority(self, now_s: float) -> None:
        """Check once, after PRIORITY_S, whether the process has real-time priority."""
        if self.has_realtime is None and now_s - self.linked_s > PRIORITY_S:
            self.has_realtime = has_realtime(self.chain.process_id)

    @property
    def is_linked(self) -> bool:
        """Whether all links of the chain exist."""
        return self.linked_s < math.inf

    def note_frames(self, now_s: float, *, is_fed: bool) -> None:
        """Update `frames` and `moved_s`. is_fed: whether `frames` should increase."""
        frames = self.chain.page.frames
        if frames != self.frames or not is_fed or not self.is_linked:
            self.frames, self.moved_s = frames, now_s

    def stands_s(self, now_s: float) -> float:
        """Return the seconds since `moved_s`."""
        return now_s - self.moved_s

    def note_links(self, now_s: float, *, exist: bool) -> None:
        """Update `linked_s`. exist: whether all links exist."""
        if not exist:
            self.linked_s = math.inf
        elif not self.is_linked:
            self.linked_s = self.moved_s = now_s
            self._linked_frames = self.chain.page.frames

    def is_settled(self, now_s: float) -> bool:
        """Whether the chain is linked, and once was for SETTLED_FRAMES or SETTLED_S and its delay.

        A playing sound begins abruptly in a new chain; without a wait, it would feel like a knock.
        """
        delay_frames = self.chain.page.delay_frames
        heard = self.chain.page.frames - self._linked_frames >= SETTLED_FRAMES + delay_frames
        longest_s = SETTLED_S + delay_frames / self.chain.plan.samplerate
        if self.is_linked and (heard or now_s - self.linked_s > longest_s):
            self.has_settled = True
        return self.is_linked and self.has_settled

    def has_left(self, graph: Graph, now_s: float) -> bool:
        """Whether the chain's links are gone, or LEAVE_S have passed since the first call."""
        self.left_s = min(self.left_s, now_s)
        nodes = [graph.node_named(name) for name in (self.chain.tap, self.chain.vibration)]
        linked = any(node and any(graph.links_of(node.id)) for node in nodes)
        return not linked or now_s - self.left_s > LEAVE_S


class Chains:
    """All chains of one engine. Any thread may read the attributes.

    current: the chain that plays. following: the chain that will replace `current`. leaving: chains
    that are being unlinked. problem: why changed settings are not applied, or "".
    """

    def __init__(
        self, config: RunConfig, folder: Path, restore: Restore, designs: DriveDesigns
    ) -> None:
        self._config, self._folder = config, folder
        self._restore, self._designs = restore, designs
        self._sound_gain, self._offset_s = 1.0, 0.0
        self._has_restarted = False
        self.problem = ""
        self.backoff = Backoff(longest_s=1.0)
        self.current: RunningChain | None = None
        self.following: RunningChain | None = None
        self.leaving: list[RunningChain] = []
        for left_over in folder.glob(f"{NAME}-*"):  # left by a killed daemon
            left_over.unlink(missing_ok=True)

    @property
    def running(self) -> list[RunningChain]:
        """The current and the following chain, if they exist."""
        return [one for one in (self.current, self.following) if one is not None]

    def follow(self, config: RunConfig) -> None:
        """Apply another config's gains and delays to the running chains."""
        self._config = config
        for running in self.running:
            self._set_actuators(running.chain, running.chain.design)

    def set_offset(self, offset_s: float) -> None:
        """Set the delay of all actuators in seconds."""
        if offset_s != self._offset_s:
            self._offset_s = offset_s
            self.follow(self._config)

    def set_sound_gain(self, gain: float) -> None:
        """Set the gain of the tapped sound."""
        self._sound_gain = gain
        for running in self.running:
            running.chain.page.set_sound_gain(gain)

    def check(self, graph: Graph, now_s: float, *, is_fed: bool) -> None:
        """If a chain has failed, close it and raise LostError. is_fed: see `note_frames`."""
        for running in reversed(self.running):
            try:
                running.chain.check()
                if running.chain.is_stopped:
                    raise LostError("the native engine's process was stopped")
                if not running.is_linked and not running.chain.is_in(graph):
                    age_s = now_s - running.began_s
                    if age_s > START_S:
                        raise LostError("the native engine did not appear in PipeWire's graph")
                    if age_s > RESTART_S and running is self.following and not self._has_restarted:
                        self._has_restarted, self.following = True, None
                        running.chain.close()
                        continue
                running.note_frames(now_s, is_fed=is_fed)
                # A current chain that has played is not closed here; `make` replaces this chain.
                is_refused = not running.frames and running.chain.complaint
                if running.stands_s(now_s) > STUCK_S and (running is self.following or is_refused):
                    raise LostError(
                        "the native engine processes nothing although sound plays"
                        f"{running.chain.last_words()}"
                    )
            except LostError:
                self.backoff.failed(now_s)
                running.chain.close()
                if running is self.following:
                    self.following = None
                else:
                    self.current = None
                raise

    def make(self, plan: ChainPlan, now_s: float) -> None:
        """Let the current chain play the plan; start a new chain if it cannot, or hangs.

        While the current chain changes, or its graph is idle, a further plan waits.
        LostError: a design cannot be computed, and no chain plays. UsageError: a rig is unknown.
        For other errors, see `Chain`.
        """
        current, following = self.current, self.following
        for running in self.running:
            if not running.chain.wanted.has_run:
                # coil temperatures have changed meanwhile
                self._restore(running.chain.wanted.rigs, False)
        if current is None or current.stands_s(now_s) > STUCK_S:
            self._begin(plan, now_s)
            return
        current.chain.note_change()
        if current.chain.plan != plan:
            if not current.chain.can_become(plan):
                self._begin(plan, now_s)
            elif not current.chain.is_changing and self.backoff.wait_s(now_s) <= 0.0:
                drives = self._designed(plan, now_s)
                if drives is not None:
                    current.chain.become(plan, drives)
            return
        self._designs.end()
        self.problem = ""
        if following is not None and not following.is_linked:
            following.chain.close()  # the current chain has recovered
            self.following = None

    def samplerate(self, graph: Graph) -> int:
        """Return the plugin's sample rate in Hz, or the expected rate before the plugin runs."""
        for running in reversed(self.running):
            if running.chain.page.samplerate:
                return running.chain.page.samplerate
            if running is self.following:
                return running.chain.plan.samplerate
        return graph.clock_hz or 48_000

    def adopt(self, now_s: float) -> None:
        """If the current chain is silent or hangs, replace it by the settled following chain."""
        old, new = self.current, self.following
        if new is None or not new.is_linked:
            return
        self._has_restarted = False
        if old is None:  # `let_play` keeps the new chain silent until it has settled
            self.current, self.following = new, None
        elif new.is_settled(now_s) and (old.is_silent or old.stands_s(now_s) >= FADE_S):
            self.leaving.append(old)
            self.current, self.following = new, None

    def let_play(self, now_s: float) -> bool:
        """Fade the chosen chain in and the other out; return whether a chain is audible.

        The chosen chain is the following chain if it is settled, else the current chain.
        """
        settled = [running for running in self.running if running.is_settled(now_s)]
        for running in self.running:
            running.chain.page.set_audible(running in settled[-1:])
        return bool(settled)

    def silence(self) -> bool:
        """Fade all chains out; return whether the fades have ended."""
        for one in self.running:
            one.chain.page.set_audible(False)
        return all(one.is_silent for one in self.running)

    def end_leaving(self, graph: Graph, now_s: float) -> None:
        """End the chains in `leaving` for which `has_left` is true."""
        for running in tuple(self.leaving):
            if running.has_left(graph, now_s):
                self.leaving.remove(running)
                running.chain.close()

    def close(self) -> None:
        """End all chains immediately. Repeated calls do nothing."""
        for running in (*self.running, *self.leaving):
            running.chain.close()
        self.current = self.following = None
        self.leaving.clear()

    def _begin(self, plan: ChainPlan, now_s: float) -> None:
        if self.following is not None:
            if self.following.chain.plan == plan:
                return
            self.following.chain.close()
            self.following = None
        if self.backoff.wait_s(now_s) > 0.0 or (drives := self._designed(plan, now_s)) is None:
            return
        realtime = self._config.live.realtime
        chain = Chain(plan, drives, self._folder, self._prepare, realtime=realtime)
        self.following = RunningChain(chain, now_s, moved_s=now_s)

    def _designed(self, plan: ChainPlan, now_s: float) -> list[DriveDesign | None] | None:
        try:
            drives = self._designs.of(plan.drive_plans(), now_s)
        except LostError:
            if self.current is None:
                raise
            drives = None
        failure = self._designs.failure if self.current is not None else ""
        self.problem = f"the former settings play on: {failure}" if failure else ""
        return drives

    def _prepare(self, chain: Chain, design: ChainDesign) -> None:
        chain.page.set_sound_gain(self._sound_gain)
        self._set_actuators(chain, chain.design if design.number else design)
        self._restore(design.rigs, True)

    def _set_actuators(self, chain: Chain, playing: ChainDesign) -> None:
        """Set gains and delays of all actuators.

        No gain rises in a design that plays with another rig, damping or protection than the config
        has: the design that follows protects the actuator at the new gain.
        """
        settings, offset_s = self._config.settings, self._offset_s
        page, plan, holds = chain.page, playing.plan, playing.plan.drives != settings.drives
        level = 0.0 if self._config.muted else db_to_amplitude(settings.gain_db)
        if not settings.actuators:
            for slot in range(len(plan.actuators)):
                page.set_actuator(slot, level, offset_s * plan.samplerate, holds=holds)
        for slot, actuator in enumerate(settings.actuators[: len(plan.actuators)]):
            delay_frames = (offset_s + 1e-3 * actuator.delay_ms) * plan.samplerate
            page.set_actuator(slot, level * actuator.factor, delay_frames, holds=holds)
