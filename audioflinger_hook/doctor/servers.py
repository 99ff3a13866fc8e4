"""Reads the sound server and PipeWire's graph; each read ends within its time limit."""

from __future__ import annotations

import json
import math
import os
import re
import socket
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from audioflinger_hook.daemon.native.chain import NAME
from audioflinger_hook.doctor.facts import GraphFacts, ServerFacts, SinkFacts
from audioflinger_hook.doctor.machine import ANSWER_S, printed
from device.errors import CushionError
from device.server import PulseConnection, ServerSnapshot
from device.server.graph import Graph
from device.server.graph_watch import READER
from device.server.identity import is_ours
from device.server.snapshot import Sink

_OURS = re.compile(rf"{NAME}(?:-(\d+)-\d+)?\.(tap|vibration)")  # nodes of chains
_SETTINGS = ("clock.rate", "clock.force-rate", "clock.quantum", "clock.force-quantum")


def read_server(environ: Mapping[str, str]) -> tuple[ServerFacts, ServerSnapshot | None]:
    """Return the facts of the sound server, and its snapshot, None if it does not answer."""
    snapshot, error, processes, latencies_s = None, "", set[int](), dict[str, float]()
    try:
        with closing(PulseConnection()) as connection:
            snapshot, processes = connection.latest, connection.processes()
            latencies_s = connection.latencies_s()
    except (CushionError, OSError) as refusal:
        error = str(refusal)
    objects = _dump() if _accepts(_pipewire_socket(environ)) else None
    graph, hangs = None, False
    if objects is None:
        hangs = snapshot is None and any(map(_accepts, _sockets(environ)))
    else:
        graph = Graph()
        graph.apply(objects)
    facts = _graph_facts(graph) if graph else None
    if snapshot is None:
        return ServerFacts(error=error, hangs=hangs, graph=facts), None
    if snapshot.kind != "PipeWire":
        graph, facts = None, None
    return ServerFacts(
        kind=snapshot.kind,
        version=snapshot.version,
        default_sink=snapshot.default_sink,
        sinks=tuple(
            _sink_facts(sink, snapshot, graph, facts, latencies_s)
            for sink in snapshot.sinks
            if not sink.name.startswith(NAME)  # silent helpers of a daemon
        ),
        players=_players(snapshot, processes),
        graph=facts,
    ), snapshot


def _dump() -> list[Any] | None:
    """Return the objects of PipeWire's graph; None if pw-dump is missing or gets no answer."""
    text, decoder = printed(READER, "--no-colors"), json.JSONDecoder()
    objects: list[Any] = []
    with suppress(ValueError):  # changes during the dump follow as further arrays
        while text := (text or "").lstrip():
            found, length = decoder.raw_decode(text)
            objects += [item for item in found if isinstance(item, dict)]
            text = text[length:]
    return objects or None


def _accepts(path: str) -> bool:
    """Whether a program accepts connections at this socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe, suppress(OSError, ValueError):
        probe.settimeout(ANSWER_S)
        probe.connect(path)
        return True
    return False


def _pipewire_socket(environ: Mapping[str, str]) -> str:
    remote = environ.get("PIPEWIRE_REMOTE") or "pipewire-0"
    folder = environ.get("PIPEWIRE_RUNTIME_DIR") or _runtime(environ)
    return remote if remote.startswith("/") else f"{folder}/{remote}"


def _sockets(environ: Mapping[str, str]) -> list[str]:
    address = environ.get("PULSE_SERVER", "")
    folder = environ.get("PULSE_RUNTIME_PATH") or f"{_runtime(environ)}/pulse"
    pulse = address.rpartition("unix:")[2] if "/" in address else f"{folder}/native"
    return [pulse, _pipewire_socket(environ)]


def _runtime(environ: Mapping[str, str]) -> str:
    return environ.get("XDG_RUNTIME_DIR") or f"/run/user/{os.getuid()}"


def _sink_facts(
    sink: Sink,
    snapshot: ServerSnapshot,
    graph: Graph | None,
    cycle: GraphFacts | None,
    latencies_s: Mapping[str, float],
) -> SinkFacts:
    """Return the facts of a sink. A delay in cycles counts as cycles of the configured quantum."""
    node, declared_s = None, latencies_s.get(sink.name)
    if graph is not None and cycle is not None:
        node = graph.sink(sink.name)
        declared_s = graph.declared_s(sink.name, cycle.cycle_frames, cycle.clock_hz)
    streams = [one for one in snapshot.sink_inputs if one.device_index == sink.index]
    return SinkFacts(
        sink.name,
        sink.samplerate,
        sink.channels,
        sink.mute,
        sink.volume_db if math.isfinite(sink.volume_db) else None,
        any(not stream.corked for stream in streams),
        node.state if node else "",
        None if declared_s is None else round(1e3 * declared_s, 3),
        node is None or node.state == "running" or "audio.rate" in node.properties,
    )


def _players(snapshot: ServerSnapshot, connected: set[int]) -> tuple[str, ...]:
    """Return what plays vibration on this server: daemons, and the plugin in a filter-chain.

    An idle daemon may have no stream, so the connected processes of `cushion run` count, too.
    """
    processes = {process for process in connected if _runs(process)}
    has_plugin = False
    for stream in snapshot.sink_inputs:
        node = _OURS.fullmatch(stream.properties.get("node.name", ""))
        if node and node[1]:
            processes.add(int(node[1]))
        elif node:
            has_plugin = True
        elif is_ours(stream) and stream.process_id is not None:
            processes.add(stream.process_id)
    found = [f"process {process}" for process in sorted(processes)]
    return (*found, *["the plugin in PipeWire's filter-chain"] * has_plugin)


def _runs(process: int) -> bool:
    """Whether a process is `cushion run`."""
    with suppress(OSError):
        return b"run" in Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")
    return False


def _graph_facts(graph: Graph) -> GraphFacts:
    rate, forced_hz, quantum, forced_frames = (
        _number(graph.settings.get(key)) for key in _SETTINGS
    )
    allowed = re.findall(r"\d+", str(graph.settings.get("clock.allowed-rates", "")))
    allowed_hz, has_manager = tuple(map(int, allowed)), graph.session_manager is not None
    cycle = quantum, forced_frames
    return GraphFacts(
        graph.version, rate, forced_hz, allowed_hz, *cycle, has_manager, tuple(_links(graph))
    )


def _links(graph: Graph) -> list[str]:
    """Return the links of the tap and the vibration. Names of other programs' nodes are left out.

    Links of several channels between the same nodes are one entry.
    """
    numbers: dict[int, str] = {}

    def shown(node_id: int) -> str:
        node = graph.nodes.get(node_id)
        if node is None or not (node.is_sink or _OURS.fullmatch(node.name)):
            return numbers.setdefault(node_id, f"stream {len(numbers) + 1}")
        return node.name

    found: dict[str, int] = {}
    for link in sorted(graph.links.values(), key=lambda link: link.id):
        ends = [graph.nodes.get(end) for end in (link.output_node_id, link.input_node_id)]
        if any(node is not None and _OURS.fullmatch(node.name) for node in ends):
            text = f"{shown(link.output_node_id)} -> {shown(link.input_node_id)} ({link.state})"
            found[text] = found.get(text, 0) + 1
    return [f"{text} x {count}" for text, count in found.items()]


def _number(value: Any) -> int:
    try:
        return max(0, int(value))
    except (TypeError, ValueError):
        return 0
