"""Finds everything that is wrong with a set-up, from its facts. No I/O."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from string import Formatter
from typing import Any

from audioflinger_hook.doctor.facts import Facts
from audioflinger_hook.doctor.texts import TEXTS
from audioflinger_hook.service.state import READY

WEAK_DB = -20.0  # the server's 46 %: vibration is a tenth as strong
FREE_MIN_BYTES = 1 << 20  # state, lock and socket need some kilobytes

Fault = tuple[str, Mapping[str, object]]  # name of a finding's texts, and values for them


@dataclass(frozen=True)
class Finding:
    """Something that is wrong. command: to type, "" for none."""

    name: str
    wrong: str
    advice: str
    command: str


class _Texts(Formatter):
    """Fills the texts. The conversion `!q` makes a word of a shell."""

    def convert_field(self, value: Any, conversion: Any) -> Any:
        return shlex.quote(value) if conversion == "q" else super().convert_field(value, conversion)


def find(facts: Facts) -> list[Finding]:
    """Return all findings, causes before their effects: in the order of their texts."""
    faults = sorted(
        (fault for check in (_simple, _repeated, _rates) for fault in check(facts)),
        key=lambda fault: list(TEXTS).index(fault[0]),
    )
    known = {**vars(facts), "felt": facts.felt, "heard": facts.heard}
    fill = _Texts().vformat
    return [
        Finding(name.split()[0], *(fill(one, (), {**known, **values}) for one in TEXTS[name]))
        for name, values in faults
    ]


def _simple(facts: Facts) -> Iterator[Fault]:
    """What can be wrong once."""
    server, graph, status, delay = facts.server, facts.graph, facts.status, facts.delay
    heard, felt, holder = facts.heard, facts.felt, facts.holder
    is_pipewire = bool(server and server.kind == "PipeWire")
    is_pulse = bool(server and server.kind == "PulseAudio")
    is_idle = status is None and not (facts.config_error or facts.mistakes)
    is_gone = not (status or facts.is_locked or facts.daemon_error)
    is_chosen = facts.engine == "python" or (status and status.engine_reason.startswith("engine ="))
    lacks_native = is_pipewire and facts.is_on_server and facts.native_problem
    applies = {
        "server-hangs": not server and facts.hangs,
        "no-pulse": not server and not facts.hangs and graph,
        "no-server": not (server or facts.hangs or graph),
        "no-session-manager": graph and graph.session_manager is None,
        "pulseaudio": is_pulse,
        "config unreadable": facts.config_error,
        "no-plugin": not facts.is_built,
        "no-native": facts.is_built and lacks_native,
        "plugin-copy": facts.installed not in ("", "current"),
        "no-alsa-plugin": is_pulse and facts.is_on_server and facts.alsa_problem,
        "wrong-default-sink": server and felt and server.default_sink == felt.name,
        "no-default-sink": server and not server.default_sink,
        "no-device": is_idle and facts.device_error,
        "no-device-chosen": is_idle and not facts.device,
        "device-muted": felt and felt.mute,
        "device-low": felt and not felt.mute and felt.volume_db < WEAK_DB,
        "sound-muted": heard and heard.mute and heard != felt,
        "no-realtime": not (facts.is_realtime or facts.rtkit),
        "daemon-hangs": not status and facts.is_locked,
        "daemon-silent": facts.daemon_error and not facts.is_locked,
        "stale-lock": is_gone and holder,
        "service-failed": facts.service == "failed",
        "no-daemon": is_gone,
        "daemon-version": status and status.version != facts.program,
        "daemon-waits": status and status.state not in READY,
        "muted": status and status.muted,
        "python-engine": is_pipewire and status and status.engine == "python" and not is_chosen,
        "monitor-tap": status and status.graph and status.graph.tap == "monitor",
        "not-felt": delay and delay.was_played and delay.delay_ms is None,
    }
    others = [one.name for one in server.sinks if one != felt] if server else []
    values = {
        "as_user": " Run cushion as the user of the desktop, not as root." * facts.is_root,
        "speakers": others[0] if len(others) == 1 else "NAME",
        "device_error": facts.device_error,
        "asked": "the system bus cannot be asked"
        if facts.rtkit is None
        else "it is not on the bus",
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
        free_kb, least_kb = (one.free_bytes or 0) >> 10, FREE_MIN_BYTES >> 10
        if one.problem:
            yield "folder", {"folder": one}
        elif one.free_bytes is not None and free_kb < least_kb:
            yield "disk-full", {"folder": one, "free_kb": free_kb, "least_kb": least_kb}
    status, players = facts.status, facts.players
    if len(players) > 1:
        known = f"process {status.pid}" if status else ""
        other = next(player for player in reversed(players) if player != known)
        process = other.removeprefix("process ")
        command = f"kill {process}" if process != other else "cushion plugin remove"
        named = {"count": len(players), "players": ", ".join(players), "command": command}
        yield "second-daemon", named
    warnings = status.warnings if status else ()
    yield from (("daemon-warns", {"warning": one}) for one in warnings)


def _rates(facts: Facts) -> Iterator[Fault]:
    """The outputs that PipeWire's graph must convert to, because it runs at another rate."""
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
    can_switch = not forced_hz and len(used_hz) == 1 and used_hz <= {*facts.clock("allowed-rates")}
    for sink in sinks:
        if sink.samplerate != graph.clock_hz and not can_switch:
            case = "forced" if forced_hz else "alone" if len(used_hz) == 1 else "both"
            yield f"rate-clash {case}", {"sink": sink}
