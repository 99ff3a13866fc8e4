"""What a chain taps, as links of the graph: the streams that play to a sink, or its monitor.

Streams are tapped by mirroring: for each link from X to the sink there is one from X to the tap. So
what is mixed at the sink is mixed at the tap, whoever linked it. The monitor of a sink that drives
the graph is read one cycle later, and cannot leave applications out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

from audioflinger_hook.daemon.inputs.applications import Applications
from device.layouts import layout
from device.server import AppRules
from device.server.graph import Graph, Link, LinkPair, Node
from device.server.snapshot import Source, Stream

OUT, IN, PLAYBACK, MONITOR = "output_", "input_", "playback_", "monitor_"
"""Beginnings of the names of ports."""

_REAR = {"BL": "RL", "BR": "RR", "BC": "RC"}  # PipeWire's names of Android's rear positions
_SIDE = {"BL": "SL", "BR": "SR", "BC": "RC"}  # if the only surrounds are at the sides


@dataclass(frozen=True)
class Tap:
    """What a chain taps.

    name: for messages. positions: channels in the mixer's order, such as ("FL", "FR"). sink: node
    that the tapped streams play to, "" for any but the device's. rules: which streams are tapped,
    None for all.
    """

    name: str
    positions: tuple[str, ...]
    sink: str
    rules: AppRules | None = None

    @property
    def channels(self) -> int:
        """How many channels it has."""
        return len(self.positions)

    @property
    def has_monitor(self) -> bool:
        """Whether the monitor of one sink has the same sound."""
        return bool(self.sink) and self.rules is None

    def mirrored(self, graph: Graph, device: str, inputs: tuple[int, ...]) -> Iterator[LinkPair]:
        """Return the links that mirror those to the sink.

        device: node of the sink that the vibration goes to. inputs: ids of the tap's ports.
        """
        for link in self.tapped_links(graph, device):
            for channel in channels_of(graph.ports[link.input_id].channel, self.positions):
                yield link.output_id, inputs[channel]

    def tapped_links(self, graph: Graph, device: str) -> Iterator[Link]:
        """Return the links to the sink whose sound is tapped."""
        haptic = graph.sink(device)
        avoided = haptic.id if haptic else None
        for sink in graph.nodes_named(self.sink) if self.sink else graph.sinks():
            if sink.id == avoided or not graph.is_sink(sink.id):
                continue
            for link in graph.links_of(sink.id):
                if link.input_node_id == sink.id and self._takes(graph, link, avoided):
                    yield link

    def monitored(self, graph: Graph, inputs: tuple[int, ...]) -> Iterator[LinkPair]:
        """Return the links from the sink's monitor. inputs: ids of the tap's ports."""
        sink = graph.sink(self.sink)
        ports = graph.ports_of(sink.id, MONITOR) if sink else {}
        for position, port in zip(self.positions, inputs, strict=True):
            if position in ports:
                yield ports[position], port

    def _takes(self, graph: Graph, link: Link, avoided: int | None) -> bool:
        output, node = graph.ports.get(link.output_id), graph.nodes.get(link.output_node_id)
        if output is None or node is None or link.input_id not in graph.ports:
            return False
        if output.is_monitor and node.id == avoided:  # it would feed back
            return False
        if self.rules is None:
            return True
        return graph.is_described(node.id) and self.rules.take(stream_of(graph, node))


def tap_of(found: Source | Applications, rules: AppRules | None) -> Tap:
    """Return the tap of a located source. rules: which applications are tapped, None for all."""
    positions = in_mixing_order(port_names(found.channel_map, found.channels))
    if isinstance(found, Source):
        return Tap(found.name, positions, found.monitor_of or "")
    return Tap(found.name, positions, found.sink, rules)


def stream_of(graph: Graph, node: Node) -> Stream:
    """Return a node as a stream, for the rules that choose applications."""
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
    """Return the channels of the tap that a port of the sink goes to.

    A position that the tap lacks goes to its side, one without a side to all channels.
    """
    if position in positions:
        return (positions.index(position),)
    side = position[-1:]
    same = tuple(
        channel
        for channel, name in enumerate(positions)
        if name[-1:] == side and side in ("L", "R")
    )
    return same or tuple(range(len(positions)))


def port_names(channel_map: str, channels: int) -> tuple[str, ...]:
    """Return the end of each channel's port name, such as "FL"; AUX0, AUX1, ... if unknown.

    channel_map: positions in order, such as "front-left,front-right".
    """
    positions = channel_map.split(",") if channel_map else []
    names = tuple(map(_port_name, positions))
    if len(names) == channels and len(set(names)) == channels:
        return names
    return tuple(f"AUX{channel}" for channel in range(channels))


def _port_name(position: str) -> str:
    """Return PipeWire's name of PulseAudio's position: initials, or the whole of one word."""
    words = position.upper().split("-")
    return words[0] if len(words) == 1 else "".join(word[:1] for word in words if word != "OF")


def in_mixing_order(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the ends of port names in the order of the mixer's layout, if they are its positions.

    The transform adds channels in this order, and its sources go by it.
    """
    for known in (_REAR, _SIDE):
        wanted = tuple(known.get(name, name) for name in layout(len(names)))
        if sorted(wanted) == sorted(names):
            return wanted
    return names
