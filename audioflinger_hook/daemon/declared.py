"""Reads the delays that the sinks of sound and vibration declare on PipeWire and PulseAudio."""

import math
from collections import deque
from collections.abc import Callable, Collection
from contextlib import suppress

from audioflinger_hook.daemon.offset import LONGEST_S, Declared
from audioflinger_hook.daemon.offset_store import SinkPair
from device.errors import NotFoundError
from device.server import PulseConnection
from device.server.graph_watch import GraphWatch

LOOK_S = 0.05  # shortest time between two queries of PulseAudio: every tick has one

# PulseAudio's latency of a sink rises when the sink fills its buffer, and falls until the next
# time. A monitor gets the sound when the buffer is filled, so a latency in the upper third counts;
# behind a tunnel, the highest ones are wrong by tens of ms. If the latest RECENT latencies differ
# from all LOOKS by JUMP_S, the sink's delay has changed, and the earlier ones are forgotten.
LOOKS, RECENT, JUMP_S = 120, 20, 0.06

# On PulseAudio, a heard sink that is later by less than this has an ordinary buffer.
ORDINARY_S = 0.02


class DeclaredDelays:
    """Reads declared delays while sound plays. Only the main thread may call the methods.

    on_change: another thread calls it when PipeWire's graph changes. warning: why a declared delay
    is ignored, in one line, or "".
    """

    def __init__(self, on_change: Callable[[], None]) -> None:
        self._on_change = on_change
        self._watch: GraphWatch | None = None
        self._looked_s = -math.inf
        self._looks: deque[tuple[float, float]] = deque(maxlen=LOOKS)
        self._pair: SinkPair | None = None
        self._last = Declared()
        self.warning = ""

    def read(
        self,
        pair: SinkPair,
        connection: PulseConnection,
        watch: GraphWatch | None,
        cycle: tuple[int, int],
        now_s: float,
        *,
        forwards: bool,
    ) -> Declared:
        """Return the delays that a pair of sinks declares.

        watch: of the native engine, None for a watch of this object's own. cycle: quantum in frames
        and sample rate in Hz. forwards: whether drop-in mode forwards the sound to the heard sink.
        LostError: the connection is lost.
        """
        if pair != self._pair:
            self._pair, self._looked_s, self._last = pair, -math.inf, Declared()
            self._looks.clear()
            self.warning = ""
        if watch is not None:
            self.close()
        if connection.latest.kind == "PipeWire":
            forwarding_s = cycle[0] / cycle[1] if forwards else 0.0  # its streams hold one cycle
            watch = watch or self._own_watch(now_s)
            if watch is None:
                return Declared(forwarding_s)
            with watch.lock:
                found = [watch.graph.declared_s(name, *cycle) or 0.0 for name in pair]
            heard_s, felt_s = self._believed(pair, *found)
            return Declared(heard_s + forwarding_s, felt_s, heard_s > 0.0)
        if now_s - self._looked_s >= LOOK_S:
            self._looked_s, latencies_s = now_s, connection.latencies_s()
            self._looks.append((latencies_s.get(pair.heard, 0.0), latencies_s.get(pair.felt, 0.0)))
            recent = list(self._looks)[-RECENT:]
            if abs(_upper_third(recent)[0] - _upper_third(self._looks)[0]) > JUMP_S:
                self._looks = deque(recent, LOOKS)
            heard_s, felt_s = self._believed(pair, *_upper_third(self._looks))
            is_known = heard_s - felt_s >= ORDINARY_S
            self._last = Declared(heard_s, felt_s, is_known, heard_s if forwards else 0.0)
        return self._last

    def close(self) -> None:
        """End the own watch of PipeWire's graph. Repeated calls do nothing."""
        if self._watch is not None:
            self._watch.close()
        self._watch = None

    def _own_watch(self, now_s: float) -> GraphWatch | None:
        if self._watch is not None and self._watch.lost:
            self.close()
        if self._watch is None and now_s - self._looked_s >= LOOK_S:
            self._looked_s = now_s
            with suppress(NotFoundError):  # without pw-dump, nothing is known
                self._watch = GraphWatch(self._on_change)
        return self._watch

    def _believed(self, pair: SinkPair, heard_s: float, felt_s: float) -> list[float]:
        """Return the delays, with 0 for a delay that cannot be true; set `warning`."""
        self.warning = ""
        believed = []
        for name, delay_s in zip(pair, (heard_s, felt_s), strict=True):
            is_possible = 0.0 <= delay_s <= LONGEST_S
            believed.append(delay_s if is_possible else 0.0)
            if not is_possible:
                self.warning = (
                    f"the sink {name!r} declares a delay of {1e3 * delay_s:.0f} ms, which is "
                    f"ignored; allowed: 0 to {1e3 * LONGEST_S:.0f} ms; `cushion sync` measures it"
                )
        return believed


def _upper_third(looks: Collection[tuple[float, float]]) -> list[float]:
    """Return the latency of each sink that a third of its latencies exceed."""
    return [sorted(each)[2 * len(each) // 3] for each in zip(*looks, strict=True)]
