"""Which links of the graph the chains have: from what they tap, and to the device. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass

from audioflinger_hook.daemon.native.taps import IN, MONITOR, OUT, PLAYBACK, Tap
from device.server.graph import Graph, LinkPair

SILENT_NODE = (
    "create-node adapter {{ factory.name=support.null-audio-sink node.name={name} "
    'node.description="Haptic Cushion (silence)" audio.position=[MONO] node.passive=true '
    "object.linger=false }}"
)
"""A sink without a media class: no program offers it, and nothing is played to it."""


@dataclass(frozen=True)
class ChainEnds:
    """The names of one chain's nodes, the channels of its tap, and whether it is to be linked.

    played: for each channel of the device, the actuator that it plays, None for none.
    """

    tap: str
    vibration: str
    channels: int
    played: tuple[int | None, ...] = ()
    linked: bool = False

    def tap_ports(self, graph: Graph) -> tuple[int, ...]:
        """Return the ids of the tap's ports in order; () until all are there."""
        node = graph.node_named(self.tap)
        ports = graph.ports_of(node.id, IN) if node else {}
        names = [f"AUX{channel}" for channel in range(self.channels)]
        return tuple(ports[name] for name in names) if ports.keys() >= set(names) else ()


@dataclass(frozen=True)
class ChainWiring:
    """What is to be linked: all chains that run, to one tap and to one device.

    device: node of the sink that the vibration goes to. device_positions: its channels, such as
    ("FL", "FR"). by_monitor: whether the sink's monitor is tapped, else its streams. silence: node
    that is made while there are chains. Its monitor, nothing but zeros, is linked to chains that
    tap streams: a linked port keeps its format, so a new stream's link has less to negotiate.
    """

    chains: tuple[ChainEnds, ...] = ()
    tap: Tap | None = None
    device: str = ""
    device_positions: tuple[str, ...] = ()
    by_monitor: bool = False
    silence: str = ""

    def nodes(self, graph: Graph) -> Set[int]:
        """Return the ids of the chains' nodes."""
        names = (name for chain in self.chains for name in (chain.tap, chain.vibration))
        return {node.id for name in names for node in graph.nodes_named(name)}

    def made_nodes(self) -> Mapping[str, str]:
        """Return the command that makes the silence, by its name.

        It is there before a chain plays, and as long: a node that joins costs the others a cycle.
        """
        used = self.silence and self.chains
        return {self.silence: SILENT_NODE.format(name=self.silence)} if used else {}

    def links(self, graph: Graph) -> Set[LinkPair]:
        """Return the links of all chains."""
        found: set[LinkPair] = set()
        for chain in self.chains:
            if chain.linked:
                found |= self.tap_links(graph, chain) | self.device_links(graph, chain)
                found |= self.silent_links(graph, chain)
        return found

    def tap_links(self, graph: Graph, chain: ChainEnds) -> set[LinkPair]:
        """Return the links to a chain's tap."""
        inputs = chain.tap_ports(graph)
        if self.tap is None or not inputs or chain.channels != self.tap.channels:
            return set()
        if self.by_monitor:
            return set(self.tap.monitored(graph, inputs))
        return set(self.tap.mirrored(graph, self.device, inputs))

    def silent_links(self, graph: Graph, chain: ChainEnds) -> set[LinkPair]:
        """Return the links from the silence to a chain's tap; none until it is there."""
        node = graph.node_named(self.silence)
        if node is None or self.by_monitor:
            return set()
        outputs = graph.ports_of(node.id, MONITOR).values()
        return {(output, port) for output in outputs for port in chain.tap_ports(graph)}

    def device_links(self, graph: Graph, chain: ChainEnds) -> set[LinkPair]:
        """Return the links from a chain to the device."""
        node, sink = graph.node_named(chain.vibration), graph.sink(self.device)
        if node is None or sink is None:
            return set()
        outputs, inputs = graph.ports_of(node.id, OUT), graph.ports_of(sink.id, PLAYBACK)
        return {
            (outputs[f"AUX{actuator}"], inputs[position])
            for position, actuator in zip(self.device_positions, chain.played, strict=True)
            if actuator is not None and f"AUX{actuator}" in outputs and position in inputs
        }

    def is_fed(self, graph: Graph) -> bool:
        """Whether a stream plays that is tapped, as far as the graph shows."""
        tap = self.tap
        return tap is not None and any(
            link.state == "active" for link in tap.tapped_links(graph, self.device)
        )


def why_unlinkable(graph: Graph, tap: Tap, device: str) -> str:
    """Return why a tap or a device cannot be linked in the graph, "" if both can."""
    if not graph.ports:
        return ""  # it is still being read
    for name, prefixes in ((tap.sink, (PLAYBACK, MONITOR)), (device, (PLAYBACK,))):
        sink = graph.sink(name) if name else None
        if name and sink is None:
            return f"PipeWire's graph has no node {name!r}: it is of another server"
        if sink is not None and not any(graph.ports_of(sink.id, prefix) for prefix in prefixes):
            return f"the sink {name!r} has no ports; choose a profile of its card that has some"
    return ""
