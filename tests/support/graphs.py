"""Objects of PipeWire's graph as `pw-dump` prints them, for tests that need no server."""

from typing import Any

from device.server.graph import Graph

Item = dict[str, Any]


def node(number: int, name: str, media_class: str = "", **properties: Any) -> Item:
    known = {"node.name": name, "media.class": media_class, "object.serial": number}
    info = {"state": "running", "props": {**known, **properties}}
    return {"id": number, "type": "PipeWire:Interface:Node", "info": info}


def port(number: int, node_id: int, name: str, *, monitor: bool = False) -> Item:
    direction = "input" if name.startswith(("playback_", "input_")) else "output"
    props: Item = {
        "node.id": node_id,
        "port.name": name,
        "audio.channel": name.rpartition("_")[2],
        **({"port.monitor": True} if monitor else {}),
    }
    info = {"direction": direction, "props": props}
    return {"id": number, "type": "PipeWire:Interface:Port", "info": info}


def link(number: int, output: int, put: int, graph: Graph, state: str = "active") -> Item:
    info = {
        "output-port-id": output,
        "input-port-id": put,
        "output-node-id": graph.ports[output].node_id,
        "input-node-id": graph.ports[put].node_id,
        "state": state,
    }
    return {"id": number, "type": "PipeWire:Interface:Link", "info": info}


def gone(number: int) -> Item:
    return {"id": number, "info": None}


def desktop() -> Graph:
    """Sinks `desk` (10), `dac` (20) and `tv` (30), and a chain's nodes (40, 50); ports follow."""
    graph = Graph()
    for first, name in ((10, "desk"), (20, "dac"), (30, "tv")):
        graph.apply([node(first, name, "Audio/Sink")])
        for at, start in ((1, "playback"), (3, "monitor")):
            graph.apply(
                port(first + at + side, first, f"{start}_F{'LR'[side]}", monitor=at == 3)
                for side in (0, 1)
            )
    graph.apply([node(40, "chain.tap"), port(41, 40, "input_AUX0"), port(42, 40, "input_AUX1")])
    graph.apply([node(50, "chain.vibration"), port(51, 50, "output_AUX0")])
    return graph


def play(graph: Graph, first: int, name: str, sink: int, **properties: Any) -> None:
    """Add a stereo stream of the node `first`, with its ports and links to a sink behind it."""
    graph.apply([node(first, name, "Stream/Output/Audio", **properties)])
    for side in (0, 1):
        graph.apply([port(first + 1 + side, first, f"output_F{'LR'[side]}")])
        graph.apply([link(first + 3 + side, first + 1 + side, sink + 1 + side, graph)])
