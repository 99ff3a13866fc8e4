"""Reads the sound server and PipeWire's graph; each read ends within its time limit."""

from __future__ import annotations

import json
import os
import re
import socket
from collections import Counter
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

from audioflinger_hook.daemon.native.chain import NAME
from audioflinger_hook.doctor.facts import Facts
from audioflinger_hook.doctor.machine import ANSWER_S, printed
from device.errors import CushionError
from device.server import PulseConnection, ServerSnapshot
from device.server.graph import Graph
from device.server.graph_watch import READER
from device.server.identity import is_ours

_OURS = re.compile(rf"{NAME}(?:-(\d+)-\d+)?\.(tap|vibration)")  # nodes of chains


def read_server(facts: Facts, environ: Mapping[str, str]) -> Facts:
    """Return the facts with those of the sound server and of PipeWire's graph."""
    graph = _graph()
    try:
        with closing(PulseConnection()) as connection:
            server, processes = connection.latest, connection.processes()
            declared_s = connection.latencies_s()
    except (CushionError, OSError) as error:
        hangs = graph is None and any(map(_accepts, _sockets(environ)))
        return replace(facts, server_error=str(error), hangs=hangs, graph=graph)
    sinks = tuple(sink for sink in server.sinks if not sink.name.startswith(NAME))
    players = _players(server, processes)
    facts = replace(facts, server=replace(server, sinks=sinks), players=players)
    if graph is None or server.kind != "PipeWire":
        return replace(facts, declared_s=declared_s)
    facts = replace(facts, graph=graph)
    # A delay in cycles counts as cycles of the configured quantum.
    cycle = facts.cycle_frames, graph.clock_hz
    delays_s = {sink.name: graph.declared_s(sink.name, *cycle) or 0.0 for sink in sinks}
    return replace(facts, declared_s=delays_s)


def links(graph: Graph) -> list[str]:
    """Return the links of the tap and the vibration, as "FROM -> TO (STATE) x CHANNELS".

    Names of other programs' nodes are left out.
    """

    def is_ours(node_id: int) -> bool:
        return node_id in graph.nodes and bool(_OURS.fullmatch(graph.nodes[node_id].name))

    def shown(node_id: int) -> str:
        is_public = graph.is_sink(node_id) or is_ours(node_id)
        return graph.nodes[node_id].name if is_public else f"stream {node_id}"

    found = Counter(
        f"{shown(link.output_node_id)} -> {shown(link.input_node_id)} ({link.state})"
        for link in sorted(graph.links.values(), key=lambda link: link.id)
        if is_ours(link.output_node_id) or is_ours(link.input_node_id)
    )
    return [f"{text} x {count}" for text, count in found.items()]


def _graph() -> Graph | None:
    """Return PipeWire's graph; None if pw-dump is missing or gets no answer."""
    graph = Graph()
    with suppress(ValueError):  # changes during the dump follow as further arrays
        for text in printed(READER, "--no-colors").split("\n]\n")[:-1]:
            graph.apply(json.loads(f"{text}\n]"))
    return graph if graph.version else None


def _sockets(environ: Mapping[str, str]) -> list[str]:
    """Return the paths of the sockets of pipewire-pulse or PulseAudio, and of PipeWire."""
    runtime = environ.get("XDG_RUNTIME_DIR") or f"/run/user/{os.getuid()}"
    address = environ.get("PULSE_SERVER", "")
    folder = environ.get("PULSE_RUNTIME_PATH") or f"{runtime}/pulse"
    pulse = address.rpartition("unix:")[2] if "/" in address else f"{folder}/native"
    remote = environ.get("PIPEWIRE_REMOTE") or "pipewire-0"
    return [pulse, str(Path(environ.get("PIPEWIRE_RUNTIME_DIR") or runtime, remote))]


def _accepts(path: str) -> bool:
    """Whether a program accepts connections at this socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe, suppress(OSError, ValueError):
        probe.settimeout(ANSWER_S)
        probe.connect(path)
        return True
    return False


def _players(server: ServerSnapshot, connected: set[int]) -> tuple[str, ...]:
    """Return what plays vibration on this server: daemons, and the plugin in a filter-chain.

    An idle daemon may have no stream, so the connected processes of `cushion run` count, too.
    """
    processes = {process for process in connected if _runs(process)}
    has_plugin = False
    for stream in server.sink_inputs:
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
