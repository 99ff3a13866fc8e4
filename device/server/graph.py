"""PipeWire's graph of nodes, ports and links, from the output of `pw-dump` and `pw-cli`.

`pw-dump` prints JSON of the same form in PipeWire 0.3 to 1.6. Names of nodes need not be
unique. The server may reuse an id at once, so a removed object must be deleted at once.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

# Programs that link streams to sinks: the beginnings of their names, which may end with a profile.
SESSION_MANAGERS = ("WirePlumber", "pipewire-media-session")
LINK_ENDS = ("output-port-id", "input-port-id", "output-node-id", "input-node-id")

LinkPair = tuple[int, int]  # ids of the output port and the input port of a link
Index = dict[Any, set[int]]  # ids of objects, by name or by the id of their node


@dataclass(frozen=True, slots=True)
class Node:
    """A node. is_sink: whether it plays sound from other nodes. state: such as "running"."""

    id: int
    name: str
    is_sink: bool
    state: str
    properties: Mapping[str, Any]


class PortLatency(NamedTuple):
    """The delay behind an input port: cycles of the graph, frames of the graph's rate, seconds."""

    cycles: float = 0.0
    frames: float = 0.0
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class Port:
    """A port. name: such as "playback_FL". channel: such as "FL", "" if unknown.

    latency: declared delay of an input port. Ports are equal if only their latencies differ.
    """

    id: int
    node_id: int
    name: str
    channel: str
    is_monitor: bool
    latency: PortLatency = field(default=PortLatency(), compare=False)


@dataclass(frozen=True, slots=True)
class Link:
    """A link between two ports. state: such as "active" or "paused"."""

    id: int
    output_id: int
    input_id: int
    output_node_id: int
    input_node_id: int
    state: str

    @property
    def pair(self) -> LinkPair:
        """The ids of the output port and the input port."""
        return self.output_id, self.input_id


class Graph:
    """The objects of one server. Not thread-safe: hold `GraphWatch.lock`.

    nodes, ports, links: by id. version: of the server, "" while unknown. clock_hz: its configured
    sample rate, 0 while unknown. settings: of the server, by PipeWire's names.
    """

    def __init__(self) -> None:
        self.nodes: dict[int, Node] = {}
        self.ports: dict[int, Port] = {}
        self.links: dict[int, Link] = {}
        self.version = ""
        self.clock_hz = 0
        self.settings: dict[Any, Any] = {}
        self._clients: dict[int, Mapping[str, Any]] = {}
        self._named: Index = {}
        self._ports_of: Index = {}
        self._links_of: Index = {}
        self._serials: dict[int, int] = {}
        self._announced: set[int] = set()
        self._changes = 0

    def apply(self, objects: Iterable[Any]) -> bool:
        """Store objects of `pw-dump`; return whether nodes, ports or links (not states) changed."""
        before = self._changes
        for item in objects:
            if isinstance(item, dict) and isinstance(item.get("id"), int):
                number = item["id"]
                if number in self._announced and _serial(item) < self._serials[number]:
                    continue  # it describes an object that had this id before
                self._announced.discard(number)
                self._apply_one(item)
        return self._changes != before

    def announce(self, objects: Iterable[Any]) -> bool:
        """Process new and removed objects that `pw-cli` reports; return the same as `apply`."""
        before = self._changes
        for item in objects:
            number, serial = item["id"], _serial(item)
            if str(item.get("type", "")).endswith(":Core"):  # the server announces all objects anew
                self._announced.clear()
            elif item.get("info") is None:
                self._forget(number)
            elif serial > self._serials.get(number, -1):
                self._apply_one(item)
                self._announced.add(number)
        return self._changes != before

    def is_described(self, node_id: int) -> bool:
        """Whether all properties of a node are known."""
        return node_id not in self._announced

    def sink(self, name: str) -> Node | None:
        """Return the sink of this name, if there is one."""
        return next((node for node in self.nodes_named(name) if node.is_sink), None)

    def nodes_named(self, name: str) -> Iterator[Node]:
        """Return all nodes of this name."""
        return (self.nodes[node_id] for node_id in self._named.get(name, ()))

    def node_named(self, name: str) -> Node | None:
        """Return a node of this name, or None."""
        return next(self.nodes_named(name), None)

    def ports_of(self, node_id: int, prefix: str = "") -> dict[str, int]:
        """Return {rest of the name: id} for those ports of a node whose names begin with prefix."""
        ports = (self.ports[port_id] for port_id in self._ports_of.get(node_id, ()))
        return {port.name[len(prefix) :]: port.id for port in ports if port.name.startswith(prefix)}

    def declared_s(self, sink: str, cycle_frames: int, samplerate: int) -> float | None:
        """Return the delay in s that a sink declares, None if the sink is unknown.

        The delay is the time from a cycle until its sound is heard, 0 if nothing is declared. It is
        that of the latest of the ports. The sink's buffer may count in cycles: see `PortLatency`.
        """
        node = self.sink(sink)
        if node is None or samplerate <= 0:
            return None
        inputs = self.ports_of(node.id, "playback_").values()
        latencies = (self.ports[port_id].latency for port_id in inputs)
        delays_s = [s + (cycles * cycle_frames + n) / samplerate for cycles, n, s in latencies]
        return max(delays_s, key=abs, default=0.0)

    def links_of(self, node_id: int) -> Iterator[Link]:
        """Return the links from and to a node."""
        return (self.links[link_id] for link_id in self._links_of.get(node_id, ()))

    @property
    def session_manager(self) -> int | None:
        """Serial number of the client that links streams to sinks; None if no such client runs."""
        for client in self._clients.values():
            if str(client.get("application.name", "")).startswith(SESSION_MANAGERS):
                return _number(client.get("object.serial"))
        return None

    def properties_of(self, node: Node) -> dict[str, str]:
        """Return the properties of a node and of the client that made it, as text."""
        client = self._clients.get(_number(node.properties.get("client.id")), {})
        return {key: str(value) for key, value in {**client, **node.properties}.items()}

    def _apply_one(self, item: Mapping[str, Any]) -> None:
        number, kind, info = item["id"], str(item.get("type", "")), item.get("info")
        if kind.endswith(":Metadata"):
            if (item.get("props") or {}).get("metadata.name") == "settings":
                found = {one.get("key"): one.get("value") for one in item.get("metadata") or ()}
                self.settings = found
                forced_hz, usual_hz = (
                    _number(found.get(f"clock.{name}")) for name in ("force-rate", "rate")
                )
                self.clock_hz = max(0, forced_hz if forced_hz > 0 else usual_hz)
            return
        if not isinstance(info, dict):
            self._forget(number)
            return
        known = info.get("props") or {}
        if kind.endswith(":Node"):
            name, state = str(known.get("node.name", "")), str(info.get("state", ""))
            is_sink = known.get("media.class") in ("Audio/Sink", "Audio/Duplex")
            self._put(self.nodes, Node(number, name, is_sink, state, known))
        elif kind.endswith(":Port"):
            name, channel = str(known.get("port.name", "")), str(known.get("audio.channel", ""))
            is_monitor = str(known.get("port.monitor")).lower() == "true"
            node_id, latency = _number(known.get("node.id")), _latency(info.get("params"))
            self._put(self.ports, Port(number, node_id, name, channel, is_monitor, latency))
        elif kind.endswith(":Link"):
            state = str(info.get("state", ""))
            output, input_, from_node, to_node = (_number(info.get(end)) for end in LINK_ENDS)
            self._put(self.links, Link(number, output, input_, from_node, to_node, state))
        elif kind.endswith(":Client"):
            if number not in self._clients:
                self._forget(number)
            self._clients[number] = known
        elif kind.endswith(":Core"):
            self.version = str(info.get("version", self.version))
        self._serials[number] = _serial(item)

    def _put(self, table: dict[int, Any], new: Node | Port | Link) -> None:
        """Store an object; it replaces any object with the same id, even of another kind."""
        if (before := table.get(new.id)) is None:
            self._forget(new.id)
        self._changes += before is None or _wiring(before) != _wiring(new)
        self._drop(new.id)
        table[new.id] = new
        for index, key in self._entries(new):
            index.setdefault(key, set()).add(new.id)

    def _forget(self, number: int) -> None:
        self._changes += self._drop(number)
        self._serials.pop(number, None)
        self._announced.discard(number)
        self._clients.pop(number, None)

    def _drop(self, number: int) -> bool:
        """Remove an object from its table and indexes; return whether the object existed."""
        table: dict[int, Any]
        for table in (self.nodes, self.ports, self.links):
            if one := table.pop(number, None):
                for index, key in self._entries(one):
                    index[key].discard(number)
                    if not index[key]:
                        del index[key]
                return True
        return False

    def _entries(self, one: Node | Port | Link) -> list[tuple[Index, Any]]:
        """Return the indexes that hold an object, each with the object's key in it."""
        if isinstance(one, Node):
            return [(self._named, one.name)]
        if isinstance(one, Port):
            return [(self._ports_of, one.node_id)]
        return [(self._links_of, node) for node in {one.output_node_id, one.input_node_id}]


def _wiring(one: Node | Port | Link) -> object:
    """Return the part of an object whose change `apply` reports; a new state is no change."""
    return one.properties if isinstance(one, Node) else one.pair if isinstance(one, Link) else one


def _latency(parameters: Any) -> PortLatency:
    """Return the latency of a port's sink side, the mean of its least and largest value."""
    for one in (parameters or {}).get("Latency") or ():
        if one.get("direction") == "Input":
            cycles, frames, nanoseconds = (
                0.5 * (one.get(f"min{unit}", 0) + one.get(f"max{unit}", 0))
                for unit in ("Quantum", "Rate", "Ns")
            )
            return PortLatency(cycles, frames, 1e-9 * nanoseconds)
    return PortLatency()


def _serial(item: Mapping[str, Any]) -> int:
    """Return an object's serial number, which is never reused; -1 for a removed object."""
    return _number(((item.get("info") or {}).get("props") or {}).get("object.serial"))


def _number(value: Any) -> int:
    try:
        return int(value)
    except (TypeError, ValueError):
        return -1
