"""Finds the faults of a set-up, from its facts; `findings.txt` has their texts."""

import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files

from audioflinger_hook.doctor.facts import Facts
from audioflinger_hook.service.state import READY
from device.server.tap_volume import muted_sink

WEAK_DB = -20.0  # the server's 46 %: vibration is a tenth as strong
FREE_MIN_BYTES = 1 << 20  # state, lock and socket need some kilobytes

# Causes come before their effects. Each finding has its name and what is wrong, then what to do and
# perhaps a command. Texts whose names begin with the same word belong to one finding. Names in
# braces are facts, or values that the checks give.
_TABLE = files("audioflinger_hook.doctor").joinpath("findings.txt").read_text(encoding="utf-8")

_FORM = re.compile(r"^([^:\n]+): (.+)\n    (.+)(?:\n    \$ (.+))?$", re.MULTILINE)
_PARTS = re.compile(r"^(.*?)(?:; (?!allowed:)([^;]+))?$", re.DOTALL)  # a warning, what to do

# {name: what is wrong, what to do, command}
TEXTS = {name: texts for name, *texts in _FORM.findall(_TABLE)}

Fault = tuple[str, Mapping[str, object]]  # name of a finding's texts, and values for them


@dataclass(frozen=True)
class Finding:
    """Something that is wrong. command: to type, "" for none."""

    name: str
    wrong: str
    advice: str
    command: str


def find(facts: Facts) -> list[Finding]:
    """Return all findings, causes before their effects: in the order of their texts."""
    faults = sorted(
        (fault for check in (_simple, _repeated, _rates) for fault in check(facts)),
        key=lambda fault: list(TEXTS).index(fault[0]),
    )
    known = {**vars(facts), "felt": facts.felt, "heard": facts.heard}
    return [
        Finding(
            name.split()[0],
            *(one.format(**{**known, **values}).replace("?.", "?") for one in TEXTS[name]),
        )
        for name, values in faults
    ]


def _simple(facts: Facts) -> Iterator[Fault]:
    """What can be wrong once."""
    server, graph, status, delay = facts.server, facts.graph, facts.status, facts.delay
    heard, felt, holder = facts.heard, facts.felt, facts.holder
    kind = server.kind if server else ""
    is_idle = status is None and not (facts.config_error or facts.mistakes)
    is_gone = not (status or facts.is_locked or facts.daemon_error)
    is_chosen = facts.live.engine == "python" or (
        status and status.engine_reason.startswith("engine =")
    )
    lacks_native = kind == "PipeWire" and facts.is_on_server and facts.native_problem
    is_python = kind == "PipeWire" and status and status.engine == "python"
    is_default = server and felt and server.default_sink == felt.name
    feeds_back = felt and heard == felt and not is_default
    applies = {
        "server-hangs": not server and facts.hangs,
        "no-pulse": not server and not facts.hangs and graph,
        "no-server": not (server or facts.hangs or graph),
        "no-session-manager": graph and graph.session_manager is None,
        "pulseaudio": kind == "PulseAudio",
        "config unreadable": facts.config_error,
        "no-plugin": not facts.is_built,
        "no-native": facts.is_built and lacks_native,
        "plugin-copy": facts.installed not in ("", "current"),
        "no-alsa-plugin": kind == "PulseAudio" and facts.is_on_server and facts.alsa_problem,
        "wrong-default-sink": is_default,
        "no-default-sink": server and not server.default_sink,
        "no-tap": is_idle and (facts.tap_error or feeds_back),
        "no-device": is_idle and facts.device_error,
        "no-device-chosen": is_idle and not facts.live.device,
        "device-muted": felt and felt.mute,
        "device-low": felt and not felt.mute and felt.volume_db < WEAK_DB,
        "sound-muted": server and heard and muted_sink(server, heard.name) and heard != felt,
        "no-realtime": not (facts.is_realtime or facts.rtkit),
        "daemon-hangs": not status and facts.is_locked,
        "daemon-silent": facts.daemon_error
        and not facts.is_locked
        and facts.daemon_error not in [folder.problem for folder in facts.folders],
        "stale-lock": is_gone and holder,
        "service-failed": facts.service == "failed",
        "no-daemon": is_gone,
        "daemon-version": status and status.version != facts.program,
        "daemon-waits": status and status.state not in READY,
        "muted": status and status.muted,
        "python-engine": is_python and not is_chosen,
        "monitor-tap": status and status.graph and status.graph.tap == "monitor",
        "not-felt": delay and delay.was_played and delay.delay_ms is None,
    }
    others = [one.name for one in server.sinks if one != felt] if server else []
    values = {
        "heard_word": shlex.quote(heard.name) if heard else "",
        "felt_word": shlex.quote(felt.name) if felt else "",
        "as_user": " Run cushion as the user of the desktop, not as root." * facts.is_root,
        "speakers": shlex.quote(others[0]) if len(others) == 1 else "NAME",
        "tap_error": facts.tap_error or "it is the output of the vibration",
        "device_error": facts.device_error,
        "asked": "it is not on the bus" if facts.rtkit is False else "the bus does not answer",
        "who": f"process {holder.pid}" if holder else "an unknown process",
        "kill": f"kill -9 {holder.pid}" if holder else "",
        "silent": facts.daemon_error or "no answer",
        "other": ", because another daemon runs" * bool(status),
        "waits": f": {status.reason}" if status and status.reason else "",
    }
    yield from ((name, values) for name, is_so in applies.items() if is_so)


def _repeated(facts: Facts) -> Iterator[Fault]:
    """What can be wrong several times: mistakes, warnings, folders and daemons."""
    yield from (("config mistake", {"mistake": one}) for one in facts.mistakes)
    yield from (("config warning", {"warning": one}) for one in facts.config_warnings)
    for one in facts.folders:
        free_kb, least_kb = one.free_bytes >> 10, FREE_MIN_BYTES >> 10
        if one.problem:
            yield "folder", {"folder": one}
        elif free_kb < least_kb:
            named = {"free_kb": free_kb, "least_kb": least_kb, "word": shlex.quote(one.path)}
            yield "disk-full", {"folder": one, **named}
    server, status, players = facts.server, facts.status, facts.players
    if len(players) > 1:
        known = f"process {status.pid}" if status else ""
        other = next(player for player in reversed(players) if player != known)
        process = other.removeprefix("process ")
        command = f"kill {process}" if process != other else "cushion plugin remove"
        named = {"count": len(players), "players": ", ".join(players), "command": command}
        yield "second-daemon", named
    used = [one.name for one in (facts.heard, facts.felt) if one]
    told = [f"{name} is muted" for name in used if server and muted_sink(server, name)]
    if status and status.graph and status.graph.tap == "monitor":
        told.append("the sink's monitor is tapped")
    for line in status.warnings if status else ():
        warning, remedy = _PARTS.findall(line)[0]
        if not line.startswith((*told,)):  # a finding of its own tells these
            named = {"warning": warning, "remedy": remedy[:1].upper() + remedy[1:]}
            yield f"daemon-warns {'remedy' if remedy else 'alone'}", named


def _rates(facts: Facts) -> Iterator[Fault]:
    """The outputs that PipeWire's graph must convert to, because it runs at another rate."""
    graph, forced_hz = facts.graph, facts.clock("force-rate")
    if graph is None or not graph.clock_hz:
        return
    sinks = {sink.name: sink for sink in (facts.heard, facts.felt) if sink}
    for node in filter(None, map(graph.sink, list(sinks))):
        if node.state != "running" and "audio.rate" not in node.properties:
            del sinks[node.name]  # a suspended sink of a card may run at another rate than it says
    used_hz = {sink.samplerate for sink in sinks.values()}
    can_switch = not forced_hz and len(used_hz) == 1 and used_hz <= {*facts.clock("allowed-rates")}
    for sink in sinks.values():
        if sink.samplerate != graph.clock_hz and not can_switch:
            case = "forced" if forced_hz else "alone" if len(used_hz) == 1 else "both"
            yield f"rate-clash {case}", {"sink": sink}
