"""The chain that plays, the next one while it settles, and those that leave the graph."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from audioflinger_hook.daemon.native.chain import NAME, Chain, has_realtime
from audioflinger_hook.daemon.native.plan import ChainPlan, DriveDesigns
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.timing import Backoff
from audioflinger_hook.drive.driven_rig import DrivenRig
from device.drive.design import DriveDesign
from device.errors import LostError
from device.server.graph import Graph
from device.units import db_to_amplitude

FADE_S = 0.4  # longest wait for a fade of 40 ms: the graph may stand still
STUCK_S = 1.0  # without progress although a stream plays, a chain is replaced
START_S = 5.0  # from the start of a process to its ports, at most
START_WAIT_S = 1.0  # longest time between two starts
SETTLED_FRAMES = 9_600  # heard before a new chain is felt: its analysis looks 0.1 s back
SETTLED_S = 0.3  # longest wait for that sound: nothing may play
PRIORITY_S = 1.0  # after which the process has its priority, or is refused it
LEAVE_S = 0.5  # longest wait for a chain's links to vanish before its process ends

# Sets what rigs begin with; the second argument tells the first call for them.
Restore = Callable[[Sequence[DrivenRig | None], bool], None]


@dataclass
class RunningChain:
    """A chain and its times in seconds. For the supervising thread alone.

    linked_s: since when it has all its links. frames, moved_s: what it has processed, and when that
    last changed. left_s: when its links were first removed.
    """

    chain: Chain
    began_s: float
    linked_s: float = math.inf
    frames: int = 0
    moved_s: float = 0.0
    left_s: float = math.inf
    has_realtime: bool | None = None

    @property
    def is_silent(self) -> bool:
        """Whether it has faded out."""
        return self.chain.page.faded_out(len(self.chain.plan.actuators))

    def look_for_priority(self, now_s: float) -> None:
        """Find out once, when it has played for a while, whether it has real-time priority."""
        if self.has_realtime is None and now_s - self.linked_s > PRIORITY_S:
            self.has_realtime = has_realtime(self.chain.process_id)

    @property
    def is_linked(self) -> bool:
        """Whether it has all its links."""
        return self.linked_s < math.inf

    def note_frames(self, now_s: float, *, is_fed: bool) -> None:
        """Note whether it has processed something; is_fed: whether it has something to."""
        frames = self.chain.page.frames
        if frames != self.frames or not is_fed or not self.is_linked:
            self.frames, self.moved_s = frames, now_s

    def stands_s(self, now_s: float) -> float:
        """Return how long it has processed nothing although it should."""
        return now_s - self.moved_s

    def is_settled(self, now_s: float) -> bool:
        """Whether its vibration is that of a chain that has always run."""
        heard = self.chain.page.frames >= SETTLED_FRAMES
        return self.linked_s < math.inf and (heard or now_s - self.linked_s > SETTLED_S)

    def has_left(self, graph: Graph, now_s: float) -> bool:
        """Whether the links are gone that are not wanted any more.

        A process that ends while linked costs all other streams of the device a cycle: a click.
        """
        self.left_s = min(self.left_s, now_s)
        nodes = [graph.node_named(name) for name in (self.chain.tap, self.chain.vibration)]
        linked = any(node and any(graph.links_of(node.id)) for node in nodes)
        return not linked or now_s - self.left_s > LEAVE_S


class Chains:
    """All chains of one engine. For the supervising thread alone; attributes are for any thread.

    current: the chain that plays, or would. following: the one that is to replace it. leaving:
    those that are being unlinked. backoff: delays starts after failures. problem: why no chain
    follows although the settings have changed, "" for nothing.
    """

    def __init__(
        self, config: RunConfig, folder: Path, restore: Restore, designs: DriveDesigns
    ) -> None:
        self._config, self._folder = config, folder
        self._restore, self._designs = restore, designs
        self._sound_gain = 1.0
        self.problem = ""
        self.backoff = Backoff(longest_s=START_WAIT_S)
        self.current: RunningChain | None = None
        self.following: RunningChain | None = None
        self.leaving: list[RunningChain] = []
        for left_over in folder.glob(f"{NAME}-*"):  # of a daemon that was killed
            left_over.unlink(missing_ok=True)

    @property
    def running(self) -> list[RunningChain]:
        """Return the current and the following chain, as far as there are any."""
        return [one for one in (self.current, self.following) if one is not None]

    def follow(self, config: RunConfig) -> None:
        """Use another config for levels and delays."""
        self._config = config
        for running in self.running:
            set_actuators(running.chain, config)

    def set_sound_gain(self, gain: float) -> None:
        """Set the factor on the tapped sound."""
        self._sound_gain = gain
        for running in self.running:
            running.chain.page.set_sound_gain(gain)

    def check(self, graph: Graph, now_s: float, *, is_fed: bool) -> None:
        """Drop chains that have ended, or hang although fed, and raise LostError for them."""
        for running in reversed(self.running):
            try:
                running.chain.check()
                if running.chain.is_stopped:
                    raise LostError("the native engine's process was stopped")
                if (
                    not running.is_linked
                    and now_s - running.began_s > START_S
                    and not running.chain.is_in(graph)
                ):
                    raise LostError("the native engine did not appear in PipeWire's graph")
                running.note_frames(now_s, is_fed=is_fed)
                # a device may be slow to begin, and a chain that has played is replaced
                is_refused = not running.frames and running.chain.complaint
                has_failed = running is self.following or is_refused
                if has_failed and running.stands_s(now_s) > STUCK_S:
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
        """Begin another chain where the present one is for something else, or is stuck.

        LostError: its design cannot be made, and no chain plays. UsageError: there is no such rig.
        """
        current, following = self.current, self.following
        if following is not None and not following.chain.page.frames:
            self._restore(following.chain.rigs, False)  # what plays goes on warming until then
        if current is None or current.chain.plan != plan or current.stands_s(now_s) > STUCK_S:
            self._begin(plan, now_s)
            return
        self._designs.end()
        self.problem = ""
        if following is not None and not following.is_linked:
            following.chain.close()  # the present one has gone on by itself
            self.following = None

    def samplerate(self, graph: Graph) -> int:
        """Return the rate at which the host runs the plugin; before it does, the server's."""
        for running in reversed(self.running):
            if running.chain.page.samplerate:
                return running.chain.page.samplerate
            if running is self.following:
                return running.chain.plan.samplerate
        return graph.clock_hz or 48_000

    def adopt(self, now_s: float) -> None:
        """Let the following chain take the place of one that has faded out."""
        old, new = self.current, self.following
        if new is None or not new.is_linked:
            return
        if old is None:
            self.current, self.following = new, None
        elif new.is_settled(now_s) and (old.is_silent or old.stands_s(now_s) >= FADE_S):
            self.leaving.append(old)
            self.current, self.following = new, None

    def let_play(self, now_s: float) -> bool:
        """Fade chains in or out; a settled following one takes over. Return whether one plays."""
        takes_over = self.following is not None and self.following.is_settled(now_s)
        chosen = self.following if takes_over else self.current
        for running in self.running:
            running.chain.page.set_audible(running is chosen and running.is_linked)
        return chosen is not None and chosen.is_linked

    def silence(self) -> bool:
        """Let all chains fade out; return whether they have."""
        running = self.running
        for one in running:
            one.chain.page.set_audible(False)
        return all(one.is_silent for one in running)

    def end_leaving(self, graph: Graph, now_s: float) -> None:
        """End the chains that have left the graph."""
        for running in tuple(self.leaving):
            if running.has_left(graph, now_s):
                self.leaving.remove(running)
                running.chain.close()

    def close(self) -> None:
        """End all chains at once. May be repeated; raises nothing."""
        for running in (*self.running, *self.leaving):
            running.chain.close()
        self.current = self.following = None
        self.leaving.clear()

    def _begin(self, plan: ChainPlan, now_s: float) -> None:
        if self.following is not None and self.following.chain.plan == plan:
            return
        if self.following is not None:
            self.following.chain.close()
            self.following = None
        if self.backoff.wait_s(now_s) > 0.0:
            return
        drives = self._designed(plan, now_s)
        if drives is None:
            return
        realtime = self._config.live.realtime
        chain = Chain(plan, drives, self._folder, self._prepare, realtime=realtime)
        self.following = RunningChain(chain, now_s, moved_s=now_s)

    def _designed(self, plan: ChainPlan, now_s: float) -> list[DriveDesign | None] | None:
        """Return the designs of a plan's drives, None while the present chain plays on."""
        drives: list[DriveDesign | None] | None = None
        try:
            drives = self._designs.of(plan.drive_plans(), now_s)
        except LostError:
            if self.current is None:
                raise
        failure = self._designs.failure if self.current is not None else ""
        self.problem = f"the former settings play on: {failure}" if failure else ""
        return drives

    def _prepare(self, chain: Chain) -> None:
        chain.page.set_sound_gain(self._sound_gain)
        set_actuators(chain, self._config)
        self._restore(chain.rigs, True)


def set_actuators(chain: Chain, config: RunConfig) -> None:
    """Set the levels and delays of a chain's actuators as a config has them."""
    settings, offset_s = config.settings, max(0.0, config.live.offset_s)
    level = 0.0 if config.muted else db_to_amplitude(settings.gain_db)
    if not settings.actuators:
        for slot in range(len(chain.plan.actuators)):
            chain.page.set_actuator(slot, level, offset_s * chain.plan.samplerate)
    for slot, actuator in enumerate(settings.actuators[: len(chain.plan.actuators)]):
        delay_s = offset_s + 1e-3 * actuator.delay_ms
        delay_frames = delay_s * chain.plan.samplerate
        chain.page.set_actuator(slot, level * actuator.factor, delay_frames)
