"""Finds everything that is wrong with a set-up, from its facts. No I/O."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from audioflinger_hook.doctor.facts import Facts, SinkFacts
from audioflinger_hook.doctor.texts import TEXTS
from audioflinger_hook.service.state import READY

WEAK_DB = -20.0  # the server's 46 %: vibration is a tenth as strong
FREE_MIN_BYTES = 1 << 20  # state, lock and socket need some kilobytes

Fault = tuple[str, Mapping[str, object]]  # name of a finding's texts, and values for them


@dataclass(frozen=True)
class Finding:
    """Something that is wrong.

    name: of the check. wrong: what is wrong, in one sentence with the value. advice: what to do.
    command: to type, "" for none. repair: name of the repair of `--fix`, "" for none.
    """

    name: str
    wrong: str
    advice: str
    command: str = ""
    repair: str = ""


def find(facts: Facts) -> list[Finding]:
    """Return all findings, causes before their effects: in the order of their texts."""
    checks = (_server, _files, _outputs, _rates, _daemons, _status)
    faults = [fault for check in checks for fault in check(facts)]
    known = {**vars(facts), "status": facts.daemon.status}
    return [
        Finding(
            str(values.get("name", text)),
            *(one.format_map({**known, **values}) for one in TEXTS[text]),
        )
        for text, values in sorted(faults, key=lambda fault: list(TEXTS).index(fault[0]))
    ]


def _server(facts: Facts) -> Iterator[Fault]:
    """A sound server must answer; the native engine needs PipeWire and a session manager."""
    server, system = facts.server, facts.system
    if not server.kind:
        as_user = " Run cushion as the user of the desktop, not as root." * system.is_root
        name = "server-hangs" if server.hangs else "no-pulse" if server.graph else "no-server"
        yield name, {"as_user": as_user}
    elif not server.default_sink:
        yield "no-default-sink", {"speakers": _speakers(facts)}
    elif server.default_sink == facts.felt:
        yield "wrong-default-sink", {"speakers": _speakers(facts)}
    if server.graph is not None and not server.graph.has_session_manager:
        yield "no-session-manager", {}
    if server.kind == "PulseAudio":
        yield "pulseaudio", {}
    if system.priority != "real-time" and not system.rtkit:
        asked = "the system bus cannot be asked" if system.rtkit is None else "it is not on the bus"
        yield "no-realtime", {"asked": asked}


def _files(facts: Facts) -> Iterator[Fault]:
    """The config must have no mistakes; folders and plugin must be usable."""
    config, plugin, kind = facts.config, facts.plugin, facts.server.kind
    if config.error:
        yield "config-unreadable", {"name": "config"}
    yield from (("config-mistake", {"name": "config", "mistake": one}) for one in config.mistakes)
    yield from (("config-warning", {"name": "config", "warning": one}) for one in config.warnings)
    for folder in facts.folders:
        path, fix = shlex.quote(folder.path), folder.can_make
        if folder.problem:
            command, repair = (f"mkdir -m 700 {path}", "folder") if fix else ("", "")
            name = f"{folder.what}-folder"
            yield "folder", {"folder": folder, "name": name, "command": command, "repair": repair}
        elif folder.free_bytes is not None and folder.free_bytes < FREE_MIN_BYTES:
            free_kb, least_kb = folder.free_bytes // 1_024, FREE_MIN_BYTES // 1_024
            case = {"folder": folder, "path": path, "free_kb": free_kb, "least_kb": least_kb}
            yield "disk-full", case
    if not plugin.built:
        yield "no-plugin", {}
    elif kind == "PipeWire" and plugin.native_problem and config.is_on_server:
        yield "no-native", {}
    if kind == "PulseAudio" and plugin.alsa_problem and config.is_on_server:
        yield "no-alsa-plugin", {}
    states = {"missing": "is missing", "other version": "is of another version"}
    if state := states.get(plugin.installed):
        yield "plugin-copy", {"state": state, "repair": "plugin" if plugin.built else ""}


def _outputs(facts: Facts) -> Iterator[Fault]:
    """A device must be chosen and present; outputs must not be muted, nor the device very low."""
    config, felt = facts.config, facts.server.sink(facts.felt)
    heard = facts.server.sink(facts.heard)
    if facts.daemon.status is None and not (config.error or config.mistakes):
        if config.device_error:
            yield "no-device", {}
        elif not config.device:
            yield "no-device-chosen", {}
    if felt is not None and felt.muted:
        yield "device-muted", _level(felt)
    elif felt is not None and (felt.volume_db is None or felt.volume_db < WEAK_DB):
        yield "device-low", _level(felt)
    if heard is not None and heard.muted and heard != felt:
        yield "sound-muted", _level(heard)
    if facts.delay is not None and facts.delay.was_played and facts.delay.delay_ms is None:
        yield "not-felt", {}


def _rates(facts: Facts) -> Iterator[Fault]:
    """PipeWire's graph should run at the rate of the outputs of sound and vibration."""
    graph = facts.server.graph
    if graph is None or not graph.clock_hz:
        return
    found = (facts.server.sink(name) for name in dict.fromkeys((facts.heard, facts.felt)))
    sinks = [sink for sink in found if sink is not None and sink.rate_is_known]
    used_hz = {sink.samplerate for sink in sinks}
    can_switch = not graph.forced_hz and len(used_hz) == 1 and used_hz <= set(graph.allowed_hz)
    for sink in sinks:
        if sink.samplerate == graph.clock_hz or can_switch:
            continue
        force = "pw-metadata -n settings 0 clock.force-rate "
        if graph.forced_hz:
            runs, todo, command = "is forced to", "End the forced rate.", f"{force}0"
        elif len(used_hz) == 1:
            todo = "Let the graph run at the rate of the output."
            runs, command = "runs at", f"{force}{sink.samplerate}"
        else:
            todo = "Give both outputs this rate in their configuration."
            runs, command = "runs at", ""
        yield "rate-clash", {"sink": sink, "runs": runs, "todo": todo, "command": command}


def _daemons(facts: Facts) -> Iterator[Fault]:
    """One daemon plays; it answers, and the lock names a living process."""
    daemon, players, holder = facts.daemon, facts.server.players, facts.daemon.holder
    status = daemon.status
    if len(players) > 1:
        known = f"process {status.pid}" if status else ""
        other = next(player for player in reversed(players) if player != known)
        process = other.removeprefix("process ")
        command = f"kill {process}" if process != other else "cushion plugin remove"
        case = {"count": len(players), "players": ", ".join(players), "command": command}
        yield "second-daemon", case
    if status is None and daemon.is_locked:
        yield (
            "daemon-hangs",
            {
                "who": f"process {holder.pid}" if holder else "an unknown process",
                "reason": daemon.error or "no answer",
                "command": f"kill -9 {holder.pid}" if holder else "",
            },
        )
    elif daemon.error:
        yield "daemon-silent", {}
    elif status is None:
        if holder is not None:
            yield "stale-lock", {}
        yield "no-daemon", {}
    if daemon.service == "failed":
        yield "service-failed", {"other": ", because another daemon runs" * (status is not None)}


def _status(facts: Facts) -> Iterator[Fault]:
    """The daemon reports no trouble."""
    if (status := facts.daemon.status) is None:
        return
    if status.version != facts.system.program:
        yield "daemon-version", {}
    if status.state not in READY:
        yield "daemon-waits", {"reason": f": {status.reason}" * bool(status.reason)}
    if status.muted:
        yield "muted", {}
    is_chosen = facts.config.engine == "python" or status.engine_reason.startswith("engine =")
    if facts.server.kind == "PipeWire" and status.engine == "python" and not is_chosen:
        yield "python-engine", {}
    if status.graph is not None and status.graph.tap == "monitor":
        yield "monitor-tap", {}
    yield from (("daemon-warns", {"warning": one}) for one in status.warnings)


def _speakers(facts: Facts) -> str:
    """Return the name of the only output beside the device, as a shell's word, else "NAME"."""
    others = [sink.name for sink in facts.server.sinks if sink.name != facts.felt]
    return shlex.quote(others[0]) if len(others) == 1 else "NAME"


def _level(sink: SinkFacts) -> dict[str, object]:
    level = 0 if sink.volume_db is None else round(100.0 * 10.0 ** (sink.volume_db / 60.0))
    return {"sink": sink, "word": shlex.quote(sink.name), "volume": f"volume {level} %"}
