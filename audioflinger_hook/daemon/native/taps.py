"""What a chain taps: the monitor of a sink, or single applications, as ports of the graph."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from audioflinger_hook.daemon.inputs.applications import Applications
from audioflinger_hook.daemon.native.ports import in_mixing_order, port_names
from device.server import ServerSnapshot
from device.server.snapshot import Source, Stream

Ports = tuple[frozenset[str], ...]
"""For each channel of the tap: the output ports that are mixed into it, as NODE:PORT."""


@dataclass(frozen=True)
class Tap:
    """A tap: its name, its format, and the node whose ports must exist ("" for none)."""

    name: str
    samplerate: int
    channels: int
    node: str
    ports: Ports


def tap_of(found: Source | Applications, graph_ports: Iterable[str]) -> Tap:
    """Return the tap of a located source; graph_ports: all ports that there are."""
    names = in_mixing_order(port_names(found.channel_map, found.channels))
    if isinstance(found, Source):
        node = found.monitor_of or ""
        ports = tuple(frozenset((f"{node}:monitor_{name}",)) for name in names)
        return Tap(found.name, found.samplerate, found.channels, node, ports)
    nodes = {node_of(stream) for stream in found.streams}
    outputs = [port for port in graph_ports if port.partition(":output_")[0] in nodes]
    taken = tuple(
        frozenset(port for port in outputs if name in _targets(port.rpartition("_")[2], names))
        for name in names
    )
    return Tap(found.name, found.samplerate, found.channels, "", taken)


def why_not_applications(found: Applications, snapshot: ServerSnapshot) -> str:
    """Return why these applications cannot be tapped by their ports, "" if they can."""
    chosen = {stream.index for stream in found.streams}
    nodes = {node_of(stream) for stream in found.streams}
    if "" in nodes:
        return "an application has no node in PipeWire's graph"
    for stream in snapshot.sink_inputs:
        if stream.index not in chosen and node_of(stream) in nodes:
            return f"another stream is called {node_of(stream)!r}, too"
    return ""


def node_of(stream: Stream) -> str:
    """Return the name of a stream's node."""
    return stream.properties.get("node.name", "")


def _targets(position: str, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the channels of the tap that an application's channel goes to.

    A channel that the tap lacks goes to its side, one without a side to all channels.
    """
    if position in names:
        return (position,)
    side = position[-1:]
    same = tuple(name for name in names if name[-1:] == side and side in ("L", "R"))
    return same or names
