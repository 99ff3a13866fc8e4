"""Finds everything that is wrong with a set-up, from its facts. No I/O."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from audioflinger_hook.daemon.run_config import SERVER_DEVICES
from audioflinger_hook.doctor.facts import Facts
from audioflinger_hook.doctor.texts import TEXTS
from audioflinger_hook.service.state import READY
from device.address import parse_device
from device.errors import CushionError

WEAK_DB = -20.0  # the server's 46 %: vibration is a tenth as strong
FREE_MIN_BYTES = 1 << 20  # state, lock and socket need some kilobytes

Fault = tuple[str, Mapping[str, object]]  # name of a finding's texts, and values for them


@dataclass(frozen=True)
class Finding:
    """Something that is wrong. command: to type, "" for none."""

    name: str
    wrong: str
    advice: str
    command: str = ""


def find(facts: Facts) -> list[Finding]:
    """Return all findings, causes before their effects: in the order of their texts."""
    checks = (_plain, _server, _folders, _levels, _rates, _daemons, _notes)
    faults = [fault for check in checks for fault in check(facts)]
    known = {**vars(facts), "felt": facts.felt}
    return [
        Finding(name.split()[0], *(one.format(**{**known, **values}) for one in TEXTS[name]))
        for name, values in sorted(faults, key=lambda fault: list(TEXTS).index(fault[0]))
    ]


def _plain(facts: Facts) -> Iterator[Fault]:
    """Everything that a comparison of facts finds."""
    server, graph, status, delay = facts.server, facts.graph, facts.status, facts.delay
    kind, felt, silent = server.kind if server else "", facts.felt, facts.daemon_error
    is_idle = status is None and not (facts.config_error or facts.mistakes)
    is_on_server, device_error = _device(facts)
    is_python = kind == "PipeWire" and status and status.engine == "python"
    is_chosen = facts.engine == "python" or (status and status.engine_reason.startswith("engine ="))
    applies = {
        "no-default-sink": server and not server.default_sink,
        "wrong-default-sink": server and felt and server.default_sink == felt.name,
        "no-session-manager": graph and graph.session_manager is None,
        "pulseaudio": kind == "PulseAudio",
        "config unreadable": facts.config_error,
        "no-plugin": not facts.is_built,
        "no-native": facts.is_built
        and kind == "PipeWire"
        and is_on_server
        and facts.native_problem,
        "no-alsa-plugin": kind == "PulseAudio" and is_on_server and facts.alsa_problem,
        "plugin-copy": facts.installed not in ("", "current"),
        "no-device": is_idle and device_error,
        "no-device-chosen": is_idle and not facts.device,
        "not-felt": delay and delay.was_played and delay.delay_ms is None,
        "daemon-silent": silent and not facts.is_locked,
        "stale-lock": facts.holder and not (status or facts.is_locked or silent),
        "no-daemon": not (status or facts.is_locked or silent),
        "daemon-version": status and status.version != facts.program,
        "muted": status and status.muted,
        "python-engine": is_python and not is_chosen,
        "monitor-tap": status and status.graph and status.graph.tap == "monitor",
    }
    others = [one.name for one in server.sinks if one != felt] if server else []
    speakers = shlex.quote(others[0]) if len(others) == 1 else "NAME"
    values = {"speakers": speakers, "device_error": device_error}
    yield from ((name, values) for name, is_so in applies.items() if is_so)


def _device(facts: Facts) -> tuple[bool, str]:
    """Return whether the config's device is a sink, and why it is not on the server."""
    if not facts.device:
        return True, ""
    address = parse_device(facts.device)
    if facts.server and address.kind in SERVER_DEVICES:
        try:
            address.sink(facts.server)
        except CushionError as error:
            return True, str(error)
    return address.kind in SERVER_DEVICES, ""


def _server(facts: Facts) -> Iterator[Fault]:
    """A sound server must answer, and audio threads must get real-time priority."""
    if facts.server is None:
        as_user = " Run cushion as the user of the desktop, not as root." * facts.is_root
        name = "server-hangs" if facts.hangs else "no-pulse" if facts.graph else "no-server"
        yield name, {"as_user": as_user}
    if facts.priority != "real-time" and not facts.rtkit:
        asked = "the system bus cannot be asked" if facts.rtkit is None else "it is not on the bus"
        yield "no-realtime", {"asked": asked}


def _folders(facts: Facts) -> Iterator[Fault]:
    """Folders must be usable, with free space."""
    for folder in facts.folders:
        path = shlex.quote(folder.path)
        if folder.problem:
            command = f"mkdir -m 700 {path}" * folder.can_make
            yield "folder", {"folder": folder, "command": command}
        elif folder.free_bytes is not None and folder.free_bytes < FREE_MIN_BYTES:
            free = {"free_kb": folder.free_bytes >> 10, "least_kb": FREE_MIN_BYTES >> 10}
            yield "disk-full", {"folder": folder, "path": path, **free}


def _levels(facts: Facts) -> Iterator[Fault]:
    """Outputs must not be muted, nor the output of the vibration very low."""
    heard, felt = facts.heard, facts.felt
    if felt is not None and (felt.mute or felt.volume_db < WEAK_DB):
        name = "device-muted" if felt.mute else "device-low"
        yield name, {"sink": felt, "word": shlex.quote(felt.name)}
    if heard is not None and heard.mute and heard != felt:
        yield "sound-muted", {"sink": heard, "word": shlex.quote(heard.name)}


def _rates(facts: Facts) -> Iterator[Fault]:
    """PipeWire's graph should run at the rate of the outputs of sound and vibration."""
    graph, forced_hz = facts.graph, facts.clock("force-rate")
    if graph is None or not graph.clock_hz:
        return
    sinks = []
    for sink in (facts.heard, facts.felt):
        node = graph.sink(sink.name) if sink else None
        # A suspended sink of a card may run at another rate than it says.
        is_known = node is None or node.state == "running" or "audio.rate" in node.properties
        if sink is not None and is_known and sink not in sinks:
            sinks.append(sink)
    used_hz = {sink.samplerate for sink in sinks}
    can_switch = not forced_hz and len(used_hz) == 1 and used_hz <= set(facts.allowed_hz)
    runs = "is forced to" if forced_hz else "runs at"
    for sink in sinks:
        if sink.samplerate == graph.clock_hz or can_switch:
            continue
        todo = "Let the graph run at the rate of the output."
        command = f"pw-metadata -n settings 0 clock.force-rate {sink.samplerate}"
        if forced_hz:
            todo, command = "End the forced rate.", "pw-metadata -n settings 0 clock.force-rate 0"
        elif len(used_hz) > 1:
            todo, command = "Give both outputs this rate in their configuration.", ""
        yield "rate-clash", {"sink": sink, "runs": runs, "todo": todo, "command": command}


def _daemons(facts: Facts) -> Iterator[Fault]:
    """One daemon plays; it answers, and the service has not failed."""
    status, players, holder = facts.status, facts.players, facts.holder
    if len(players) > 1:
        known = f"process {status.pid}" if status else ""
        other = next(player for player in reversed(players) if player != known)
        process = other.removeprefix("process ")
        command = f"kill {process}" if process != other else "cushion plugin remove"
        named = {"count": len(players), "players": ", ".join(players), "command": command}
        yield "second-daemon", named
    if status is None and facts.is_locked:
        who = f"process {holder.pid}" if holder else "an unknown process"
        command = f"kill -9 {holder.pid}" if holder else ""
        reason = facts.daemon_error or "no answer"
        yield "daemon-hangs", {"who": who, "reason": reason, "command": command}
    if status is not None and status.state not in READY:
        yield "daemon-waits", {"reason": f": {status.reason}" * bool(status.reason)}
    if facts.service == "failed":
        yield "service-failed", {"other": ", because another daemon runs" * bool(status)}


def _notes(facts: Facts) -> Iterator[Fault]:
    """The mistakes and warnings of the config file, and the daemon's warnings."""
    yield from (("config mistake", {"mistake": one}) for one in facts.mistakes)
    yield from (("config warning", {"warning": one}) for one in facts.config_warnings)
    warnings = facts.status.warnings if facts.status else ()
    yield from (("daemon-warns", {"warning": one}) for one in warnings)
