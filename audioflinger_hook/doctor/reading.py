"""Reads the facts of a set-up, each within a time limit. Facts that cannot be read are empty."""

import json
import os
import platform
import re
import resource
import shutil
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from audioflinger_hook import __version__
from audioflinger_hook.config.file import default_path
from audioflinger_hook.core import library_path
from audioflinger_hook.daemon.native.abilities import missing_parts
from audioflinger_hook.daemon.native.chain import NAME
from audioflinger_hook.daemon.run_config import CARD_DEVICES, PACED_TAPS, SERVER_DEVICES
from audioflinger_hook.doctor.facts import OURS, Facts, Folder
from audioflinger_hook.pipeline.framework import find_mistakes
from audioflinger_hook.plugin.install import Places
from audioflinger_hook.service.install import NAME as SERVICE
from audioflinger_hook.service.install import printed, state_folder
from audioflinger_hook.service.runtime_folder import VARIABLE, RuntimeFolder, folder_path, read_lock
from audioflinger_hook.service.status_client import ask_status
from audioflinger_hook.sources import open_tap, parse_tap
from device.address import parse_device
from device.alsa.cards import find_playback
from device.errors import CushionError, NoAnswerError, NotFoundError
from device.server import PulseConnection, ServerSnapshot
from device.server.graph import Graph
from device.server.graph_watch import READER
from device.server.identity import find_sink, is_ours
from device.stream import AudioPriority
from device.stream.pcms import FALLBACK_SINK, missing_plugin

ANSWER_S = 3.0  # longest time in s for one program, server or daemon to answer
_printed = partial(printed, limit_s=ANSWER_S)

_JOURNAL = f"journalctl --user -u {SERVICE} -q -n 500 -o short-iso --no-hostname".split()
_ERROR = re.compile(rf"^(\S+) .*?\]: (cushion: (?:error|warning): .+|{SERVICE}: Failed .+)", re.M)

_BUS = "org.freedesktop.DBus"
_LIST_SERVICES = (  # of the system bus, with one of two programs
    f"busctl --system call {_BUS} / {_BUS} ListActivatableNames || "
    f"dbus-send --system --print-reply --dest={_BUS} / {_BUS}.ListActivatableNames"
)


def read_facts(environ: Mapping[str, str], clock: Callable[[], float]) -> Facts:
    """Return all facts but the delay, within about 15 s. Only the main thread may call it."""
    return _with_daemon(_with_config(_with_server(_machine(environ))), clock, environ)


def _machine(environ: Mapping[str, str]) -> Facts:
    """Return versions and permissions of this machine and user, folders and the plugin's files."""
    distribution = ""
    with suppress(OSError):
        distribution = platform.freedesktop_os_release().get("PRETTY_NAME", "")
    services = _printed("sh", "-c", _LIST_SERVICES)
    kernel = f"{platform.system()} {platform.release()} {platform.machine()}"
    return Facts(
        program=__version__,
        system=f"Python {platform.python_version()}, {distribution}, {kernel}",
        pipewire=_version("pipewire"),
        wireplumber=_version("wireplumber"),
        is_root=os.geteuid() == 0,
        is_realtime=_gets_realtime(),
        rtprio_limit=resource.getrlimit(resource.RLIMIT_RTPRIO)[0],
        rtkit="org.freedesktop.RealtimeKit1" in services if services else None,
        folders=(
            _folder("runtime", lambda: _runtime_folder(environ), environ.get(VARIABLE, "")),
            _folder("state", lambda: state_folder(environ)),
            _folder("config", lambda: default_path().parent),
        ),
        is_built=library_path() is not None,
        installed=_installed(environ),
        native_problem=missing_parts(),
        alsa_problem=missing_plugin(),
    )


def _with_server(facts: Facts) -> Facts:
    graph = _graph()
    try:
        with closing(PulseConnection()) as connection:
            server, processes = connection.latest, connection.processes()
            latencies_s = connection.latencies_s()
    except (CushionError, OSError) as error:
        hangs = graph is None and isinstance(error, NoAnswerError)
        return replace(facts, server_error=str(error), hangs=hangs, graph=graph)
    sinks = tuple(one for one in server.sinks if not one.name.startswith((NAME, FALLBACK_SINK)))
    graph, players = graph if server.kind == "PipeWire" else None, _players(server, processes)
    known = replace(facts, server=replace(server, sinks=sinks), players=players, graph=graph)
    return replace(known, latencies_s=latencies_s)


def _with_config(facts: Facts) -> Facts:
    path = default_path()
    if not path.exists():
        return facts
    try:
        found, warnings, mistakes = find_mistakes(path)
    except CushionError as error:
        return replace(facts, config_error=str(error))
    facts = replace(facts, mistakes=tuple(mistakes), config_warnings=tuple(warnings))
    if found is None:
        return facts
    facts = replace(facts, live=found.live)
    tap = parse_tap(found.live.tap[0])
    try:
        if tap.kind == "sink" and facts.server:
            find_sink(facts.server, tap.name)
        elif tap.kind in PACED_TAPS:
            open_tap(tap).close()
    except CushionError as error:
        facts = replace(facts, tap_error=str(error))
    if not found.live.device:
        return facts
    address = parse_device(found.live.device)
    try:
        if (is_on_server := address.kind in SERVER_DEVICES) and facts.server:
            address.sink(facts.server)
        elif address.kind in CARD_DEVICES:
            find_playback(address.name)
    except CushionError as error:
        return replace(facts, device_error=str(error))
    return replace(facts, is_on_server=is_on_server)


def _with_daemon(facts: Facts, clock: Callable[[], float], environ: Mapping[str, str]) -> Facts:
    status, error = None, ""
    try:
        status = ask_status(ANSWER_S, clock, environ)
    except NotFoundError:  # no daemon runs
        pass
    except CushionError as refusal:
        error = str(refusal)
    holder, is_locked = read_lock(environ)
    # `systemctl` prints the state also if it returns another code than 0.
    service = _printed("sh", "-c", f"systemctl --user is-active {SERVICE} || true").strip()
    journal = _printed(*_JOURNAL) if service else ""  # its lines have no priorities, only texts
    errors = tuple(map(" ".join, _ERROR.findall(journal)[-5:]))
    known = replace(facts, status=status, daemon_error=error, service=service, errors=errors)
    return replace(known, holder=holder, is_locked=is_locked)


def _version(program: str) -> str:
    return (_printed(program, "--version").split() or [""])[-1]


def _gets_realtime() -> bool:
    """Whether an audio thread of this user gets real-time priority."""
    priority = AudioPriority()

    def claim() -> bool:
        priority.claim()
        return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_RR, os.SCHED_FIFO)

    with ThreadPoolExecutor(1) as thread:
        return thread.submit(claim).result()


def _runtime_folder(environ: Mapping[str, str]) -> Path:
    with suppress(NotFoundError), RuntimeFolder(environ, create=False):  # the daemon makes it
        pass
    return folder_path(environ)


def _folder(what: str, path_of: Callable[[], Path], named: str = "") -> Folder:
    """Return the facts of a folder. named: the path that the user gave."""
    try:
        path = path_of()
        existing = next((one for one in (path, *path.parents) if one.exists()), Path("/"))
        free_bytes = shutil.disk_usage(existing).free
    except (CushionError, OSError) as error:
        return Folder(what, named, problem=str(error))
    problem = ""
    if not existing.is_dir():
        problem = f"{existing} is not a folder; rename or remove it"
    elif not os.access(existing, os.W_OK | os.X_OK):
        problem = f"this user may not write to {existing}; change its owner or rights"
    return Folder(what, str(path), free_bytes, problem)


def _installed(environ: Mapping[str, str]) -> str:
    built = library_path()
    with suppress(CushionError, OSError):
        places = Places(environ)
        if places.plugin.is_file():
            is_same = built is None or places.plugin.read_bytes() == built.read_bytes()
            return "current" if is_same else "of another version"
        if places.chain.exists() or places.bundle.exists():
            return "missing"
    return ""


def _graph() -> Graph | None:
    """Return PipeWire's graph; None if pw-dump is missing or gets no answer."""
    graph = Graph()
    with suppress(ValueError):  # changes during the dump follow as further arrays
        for text in _printed(READER, "--no-colors").split("\n]\n")[:-1]:
            graph.apply(json.loads(f"{text}\n]"))
    return graph if graph.version else None


def _players(server: ServerSnapshot, connected: set[int]) -> tuple[str, ...]:
    """Return the programs that play vibration here: daemons, and the plugin in a filter-chain.

    An idle daemon may have no stream, so the connected processes of `cushion run` count, too.
    """
    processes = set[int]()
    for process in connected:
        with suppress(OSError):
            if b"run" in Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0"):
                processes.add(process)
    has_plugin = False
    for stream in server.sink_inputs:
        node = re.fullmatch(OURS, stream.properties.get("node.name", ""))
        if node and node[1]:
            processes.add(int(node[1]))
        elif node:
            has_plugin = True
        elif is_ours(stream) and stream.process_id is not None:
            processes.add(stream.process_id)
    found = [f"process {process}" for process in sorted(processes)]
    return (*found, *["the plugin in PipeWire's filter-chain"] * has_plugin)
