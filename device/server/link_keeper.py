"""Keeps the links of our nodes in PipeWire's graph equal to the wanted links."""

from collections.abc import Callable, Collection, Mapping, Set
from typing import Protocol

from device.server.graph import Graph, Link, LinkPair

RETRY_S = 0.1  # shortest time between two equal requests
HOLDS_S = 0.2  # a link that exists for a shorter time counts as missing
PAUSED_S = 0.3
"""Longest time for a paused link while another link of the same nodes is active. PipeWire 0.3.65
sometimes resumes only one of several links. The others stay silent until they are made again."""


class Wiring(Protocol):
    """Tells which links and nodes are wanted. The methods are called with the graph locked."""

    def nodes(self, graph: Graph) -> Set[int]:
        """Return the ids of our nodes. Unwanted links of these nodes are removed."""

    def links(self, graph: Graph) -> Set[LinkPair]:
        """Return the wanted links."""

    def made_nodes(self) -> Mapping[str, str]:
        """Return the `pw-cli` commands that make the wanted nodes, keyed by node name."""


class LinkKeeper:
    """Requests missing links and nodes, and the removal of unwanted ones. Never waits.

    The thread that reads the graph calls `update` after changes. Another thread also calls it, to
    repeat requests that had no effect. Both threads hold the graph's lock.
    send: function that takes one `pw-cli` command. wiring: the wanted links, None if all links are
    permitted; call `update` after a change of `wiring`.
    """

    def __init__(self, graph: Graph, send: Callable[[str], None]) -> None:
        self._graph, self._send = graph, send
        self._asked_s: dict[str, float] = {}  # by command
        self._made: set[str] = set()
        self._missing_s: dict[LinkPair, float] = {}
        self._present_s: dict[LinkPair, float] = {}
        self._paused_s: dict[int, float] = {}
        self.wiring: Wiring | None = None

    def update(self, now_s: float) -> None:
        """Send each needed request, unless it was already sent less than RETRY_S ago."""
        graph = self._graph
        if self.wiring is None:
            return
        wanted, nodes = self.wiring.links(graph), self.wiring.nodes(graph)
        links = {link.id: link for node_id in nodes for link in graph.links_of(node_id)}
        present = {link.pair for link in links.values()}
        self._asked_s = {what: s for what, s in self._asked_s.items() if now_s - s < RETRY_S}
        for link in links.values():
            if link.pair not in wanted:
                self._ask(f"destroy {link.id}", now_s)
        properties = "{ link.passive=true object.linger=false }"
        for output_id, input_id in wanted - present:
            self._ask(f"create-link -1 {output_id} -1 {input_id} {properties}", now_s)
        made = self.wiring.made_nodes()
        self._made.update(made)
        for name in self._made:
            found = list(graph.nodes_named(name))
            if name in made and not found:
                self._ask(made[name], now_s)
            for node in found[name in made :]:  # a busy server may have made two nodes
                self._ask(f"destroy {node.id}", now_s)
        missing, there = self._missing_s, self._present_s
        self._present_s = {pair: there.get(pair, now_s) for pair in wanted & present}
        self._missing_s = {
            pair: missing.get(pair, now_s)
            for pair in wanted
            if now_s - self._present_s.get(pair, now_s) < HOLDS_S
            and (pair not in present or pair in missing)
        }
        self._renew_paused(links.values(), now_s)

    def missing(self, pairs: Set[LinkPair]) -> Set[LinkPair]:
        """Return which of these wanted links did not exist when `update` was last called."""
        return pairs - self._present_s.keys()

    def missing_for_s(self, pairs: Set[LinkPair], now_s: float) -> float:
        """Return the longest time in s for which one of these wanted links has been missing."""
        return max((now_s - self._missing_s.get(pair, now_s) for pair in pairs), default=0.0)

    def _ask(self, command: str, now_s: float) -> None:
        if command not in self._asked_s:
            self._asked_s[command] = now_s
            self._send(command)

    def _renew_paused(self, links: Collection[Link], now_s: float) -> None:
        """Remove links that the server has left paused; a later update makes them again."""
        ours = {node.id for name in self._made for node in self._graph.nodes_named(name)}
        active = {
            (link.output_node_id, link.input_node_id) for link in links if link.state == "active"
        }
        before, self._paused_s = self._paused_s, {}
        for link in links:
            ends = link.output_node_id, link.input_node_id
            if link.state == "paused" and ends in active and link.output_node_id not in ours:
                since_s = self._paused_s[link.id] = before.get(link.id, now_s)
                if now_s - since_s > PAUSED_S:
                    self._ask(f"destroy {link.id}", now_s)
