"""One chain while it runs: since when it is linked, whether it has settled, and how it leaves."""

from __future__ import annotations

import math
from dataclasses import dataclass

from audioflinger_hook.daemon.native.chain import Chain, has_realtime
from device.server.graph import Graph

SETTLED_FRAMES = 9_600  # heard before a new chain is felt: its analysis looks 0.1 s back
SETTLED_S = 0.3  # longest wait for that sound: nothing may play
PRIORITY_S = 1.0  # after which the process has its priority, or is refused it
LEAVE_S = 0.5  # longest wait for a chain's links to vanish before its process ends


@dataclass
class RunningChain:
    """A chain and its times in seconds. For the supervising thread alone.

    began_s: its start. linked_s: since when it has all its links. frames, moved_s: what it has
    processed, and when that last changed. left_s: when its links were first removed. has_realtime:
    whether its process has real-time priority, None before that is known.
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

        A process that ends while its nodes are linked keeps the cycle waiting, which costs all
        other streams of the device a cycle: a click.
        """
        self.left_s = min(self.left_s, now_s)
        nodes = [graph.node_named(name) for name in (self.chain.tap, self.chain.vibration)]
        linked = any(node and any(graph.links_of(node.id)) for node in nodes)
        return not linked or now_s - self.left_s > LEAVE_S
