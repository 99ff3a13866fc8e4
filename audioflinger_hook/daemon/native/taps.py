"""Links in PipeWire's graph: from the tap to chains, and from chains to the device.

A chain taps a stream by parallel links: for each link from the stream to the sink, a second link
leads to the chain. Alternatively, a chain taps the sink's monitor, which contains the sound of all
applications. The monitor is one cycle late if the sink drives the graph.
"""

from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass
from functools import lru_cache

from audioflinger_hook.daemon.inputs.applications import Applications
from device.layouts import layout
from device.server import AppRules
from device.server.graph import Graph, Link, LinkPair, Node
from device.server.left_out import ROLES_ONLY, LeftOut
from device.server.snapshot import Source, Stream

# Prefixes of port names.
OUT, IN, PLAYBACK, MONITOR = "output_", "input_", "playback_", "monitor_"

# The sink of a program that plays trials, whose rear channel is the vibration.
TRIALS, FELT = "cushion-trials", "RL"

_REAR = {"BL": "RL", "BR": "RR", "BC": "RC"}  # PipeWire's names of Android's rear positions
_SIDE = {"BL": "SL", "BR": "SR", "BC": "RC"}  # if surround channels exist only at the sides


@dataclass(frozen=True)
class Tap:
    """The sound that chains tap. name: for messages. rules: select streams, None for all.

    left_out: streams that are not tapped although `rules` select them. positions: channels in the
    mixer's order, such as ("FL", "FR"). sink: node to which tapped streams play, "" for all sinks
    except the device. is_trial: whether the tap is the vibration of trials instead of sound.
    """

    name: str
    positions: tuple[str, ...]
    sink: str
    rules: AppRules | None = None
    left_out: LeftOut = ROLES_ONLY
    is_trial: bool = False

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.positions)

    @property
    def has_monitor(self) -> bool:
        """Whether the monitor of one sink contains exactly the tapped streams."""
        return bool(self.sink) and self.rules is None

    def mirrored(self, graph: Graph, device: str, inputs: tuple[int, ...]) -> Iterator[LinkPair]:
        """Yield the links that lead to a chain's ports `inputs`, parallel to `tapped_links`."""
        for link in self.tapped_links(graph, device):
            for channel in channels_of(graph.ports[link.input_id].channel, self.positions):
                yield link.output_id, inputs[channel]

    def tapped_links(self, graph: Graph, device: str) -> Iterator[Link]:
        """Yield the links from tapped streams to sinks. device: sink to leave out."""
        haptic = graph.sink(device)
        avoided = haptic.id if haptic else None
        microphones = tuple(  # streams that record from anything except the monitor of a sink
            stream_of(graph, node)
            for node in graph.nodes.values()
            if node.properties.get("media.class") == "Stream/Input/Audio"
            and str(node.properties.get("stream.capture.sink")).lower() != "true"
        )
        for sink in graph.nodes_named(self.sink) if self.sink else graph.nodes.values():
            if sink.id == avoided or not sink.is_sink:
                continue
            for link in graph.links_of(sink.id):
                if link.input_node_id == sink.id and self._takes(graph, link, avoided, microphones):
                    yield link

    def monitored(self, graph: Graph, inputs: tuple[int, ...]) -> Iterator[LinkPair]:
        """Yield the links from the sink's monitor to a chain's ports `inputs`."""
        sink = graph.sink(self.sink)
        ports = graph.ports_of(sink.id, MONITOR) if sink else {}
        for position, port in zip(self.positions, inputs, strict=True):
            if position in ports:
                yield ports[position], port

    def _takes(
        self, graph: Graph, link: Link, avoided: int | None, microphones: tuple[Stream, ...]
    ) -> bool:
        output, node = graph.ports.get(link.output_id), graph.nodes.get(link.output_node_id)
        if output is None or node is None or link.input_id not in graph.ports:
            return False
        # An announcement lacks process, title and latency. The description precedes the link.
        if not graph.is_described(node.id):
            return False
        if output.is_monitor and node.id == avoided:  # the monitor would cause feedback
            return False
        stream = stream_of(graph, node)
        if not output.is_monitor and self.left_out.why(stream, microphones):
            return False
        return self.rules is None or self.rules.take(stream)


def tap_of(
    found: Source | Applications, rules: AppRules | None, left_out: LeftOut = ROLES_ONLY
) -> Tap:
    """Return the tap for a source from `Input.locate`. For `rules` and `left_out`, see `Tap`."""
    positions = in_mixing_order(port_names(found.channel_map, found.channels))
    if isinstance(found, Source):
        return Tap(found.name, positions, found.monitor_of or "", None, left_out)
    return Tap(found.name, positions, found.sink, rules, left_out)


def stream_of(graph: Graph, node: Node) -> Stream:
    """Return the `Stream` of a node, by which rules select applications."""
    known = graph.properties_of(node)
    process_id = known.get("application.process.id", "")
    return Stream(
        index=int(known.get("object.serial", node.id)),
        device_index=None,
        device_name="",
        application=known.get("application.name", node.name),
        binary=known.get("application.process.binary", ""),
        role=known.get("media.role", ""),
        media=known.get("media.name", ""),
        process_id=int(process_id) if process_id.isdecimal() else None,
        corked=node.state != "running",
        mute=False,
        properties=known,
    )


@lru_cache(maxsize=256)
def channels_of(position: str, positions: tuple[str, ...]) -> tuple[int, ...]:
    """Return the channels at this position, else on the same side, else all channels."""
    if position in positions:
        return (positions.index(position),)
    side = position[-1:]
    same = [n for n, name in enumerate(positions) if side in ("L", "R") and name[-1:] == side]
    return tuple(same or range(len(positions)))


def port_names(channel_map: str, channels: int) -> tuple[str, ...]:
    """Return endings of port names, such as FL for "front-left"; AUX0, AUX1, ... if unknown."""
    names = tuple(map(_port_name, channel_map.split(",") if channel_map else ()))
    if len(names) == channels and len(set(names)) == channels:
        return names
    return tuple(f"AUX{channel}" for channel in range(channels))


def _port_name(position: str) -> str:
    words = position.upper().split("-")
    return words[0] if len(words) == 1 else "".join(word[:1] for word in words if word != "OF")


def in_mixing_order(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return names from `port_names` in the mixer's order; keep the order of unknown layouts."""
    for known in (_REAR, _SIDE):
        wanted = tuple(known.get(name, name) for name in layout(len(names)))
        if sorted(wanted) == sorted(names):
            return wanted
    return names


SILENT_NODE = (  # without a media class, so that no program plays to it
    "create-node adapter {{ factory.name=support.null-audio-sink node.name={name} "
    'node.description="Haptic Cushion (silence)" audio.position=[MONO] node.passive=true '
    "object.linger=false }}"
)


@dataclass(frozen=True)
class ChainEnds:
    """The nodes of one chain. tap, vibration: names of the nodes.

    channels: number of the tap's channels. played: index of the actuator for each channel of the
    device, or None. linked: whether to link `tap` to its sources, and `vibration` to the device.
    """

    tap: str
    vibration: str
    channels: int
    played: tuple[int | None, ...] = ()
    linked: bool = False

    def tap_ports(self, graph: Graph) -> tuple[int, ...]:
        """Return the ids of the tap's ports in order; () until all ports exist."""
        node = graph.node_named(self.tap)
        ports = graph.ports_of(node.id, IN) if node else {}
        names = [f"AUX{channel}" for channel in range(self.channels)]
        return tuple(ports[name] for name in names) if ports.keys() >= set(names) else ()


@dataclass(frozen=True)
class ChainWiring:
    """The wanted links of all chains.

    device: sink of the vibration. device_positions: channels of the sink, such as ("FL", "FR").
    by_monitor: whether the sink's monitor is tapped, instead of streams.
    silence: node that sends zeros to chains that tap streams. A link of this node sets the format
        of a chain's port, so that a new stream is linked faster.
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
        """Return {silent node's name: command that creates the node}; empty without chains."""
        used = self.silence and self.chains
        return {self.silence: SILENT_NODE.format(name=self.silence)} if used else {}

    def links(self, graph: Graph) -> Set[LinkPair]:
        """Return the wanted links of all chains."""
        found: set[LinkPair] = set()
        for chain in self.chains:
            if chain.linked:
                found |= self.tap_links(graph, chain) | self.device_links(graph, chain)
                found |= self.silent_links(graph, chain)
        return found

    def tap_links(self, graph: Graph, chain: ChainEnds) -> set[LinkPair]:
        """Return the wanted links to a chain's tap."""
        inputs = chain.tap_ports(graph)
        if self.tap is None or not inputs or chain.channels != self.tap.channels:
            return set()
        if self.by_monitor:
            return set(self.tap.monitored(graph, inputs))
        return set(self.tap.mirrored(graph, self.device, inputs))

    def silent_links(self, graph: Graph, chain: ChainEnds) -> set[LinkPair]:
        """Return the wanted links from the silent node to a chain's tap."""
        node = graph.node_named(self.silence)
        if node is None or self.by_monitor:
            return set()
        outputs = graph.ports_of(node.id, MONITOR).values()
        return {(output, port) for output in outputs for port in chain.tap_ports(graph)}

    def device_links(self, graph: Graph, chain: ChainEnds) -> set[LinkPair]:
        """Return the wanted links from a chain to the device."""
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
        """Whether the graph shows that a tapped stream plays."""
        tap = self.tap
        return tap is not None and any(
            link.state == "active" for link in tap.tapped_links(graph, self.device)
        )


def why_unlinkable(graph: Graph, tap: Tap, device: str) -> str:
    """Return why tap or device cannot be linked, "" if both can be linked."""
    if not graph.ports:
        return ""  # the graph is still being read
    for name, prefixes in ((tap.sink, (PLAYBACK, MONITOR)), (device, (PLAYBACK,))):
        sink = graph.sink(name) if name else None
        if name and sink is None:
            return f"PipeWire's graph has no node {name!r}: it is of another server"
        if sink is not None and not any(graph.ports_of(sink.id, prefix) for prefix in prefixes):
            return f"the sink {name!r} has no ports; choose a profile of its card that has some"
    return ""
