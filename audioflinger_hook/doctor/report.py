"""Findings and facts as text, and the removal of personal names from a text. No I/O."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from audioflinger_hook.doctor.checks import Finding
from audioflinger_hook.doctor.facts import Facts, SinkFacts

# Paths outside these folders may be names that the user gave.
_SYSTEM = ("/usr/", "/etc/", "/proc/", "/dev/", "/lib")
_QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
# A path may contain spaces, so everything up to the next clause counts as its name.
_PATH = re.compile(r"(?<![\w.~/])(?:file:|capture:|wav:)?[~.]{0,2}/[^;:,)'\"]*")
_PLAIN = re.compile(r"[-+.\w]{0,2}|[-+.\deE_]+|true|false")  # values that are no names
_NAMED = ("app", "file", "capture", "wav")  # kinds of taps and devices with a private name
HIDDEN = "(hidden)"


@dataclass(frozen=True)
class Person:
    """Names to be left out: the user's name, home folder, and machine."""

    user: str = ""
    home: str = ""
    host: str = ""


def findings_text(findings: Sequence[Finding], repairs: Sequence[str]) -> str:
    """Return all findings, numbered, each with what to do, and what was repaired."""
    lines = [] if findings else ["Nothing is wrong."]
    for number, finding in enumerate(findings, 1):
        lines.append(f"{number}. {finding.wrong}")
        lines += [f"   {finding.advice}"] * bool(finding.advice)
        lines += [f"       {finding.command}"] * bool(finding.command)
    lines += [f"repaired: {done}" for done in repairs]
    return "\n".join(lines)


def facts_text(facts: Facts) -> str:
    """Return all facts, one for each line."""
    return "\n".join(f"{label + ':':<16}{text}" for label, text in _rows(facts) if text)


def full_report(
    facts: Facts, findings: Sequence[Finding], repairs: Sequence[str], person: Person
) -> str:
    """Return findings and facts without names of the user's files, windows, streams and machine."""
    keep = {sink.name for sink in facts.server.sinks}
    text = f"{findings_text(findings, repairs)}\n\n{facts_text(facts)}\n"
    for word in sorted(_private_words(facts), key=len, reverse=True):
        text = text.replace(word, HIDDEN)
    return "\n".join(anonymous(line, keep, person) for line in text.split("\n"))


def _private_words(facts: Facts) -> Iterator[str]:
    """Return the user's own words: values in the config file, and names of taps and devices."""
    for mistake in facts.config.mistakes:
        value = mistake.value.strip('"')
        if not _PLAIN.fullmatch(value):
            yield value
        if "is not TOML" in mistake.problem:
            yield mistake.key  # the text of the line
    addresses = [facts.config.tap, facts.config.device]
    if (status := facts.daemon.status) is not None:
        addresses += [status.tap.address, status.device.address]
    for address in addresses:
        kind, _, name = address.partition(":")
        if kind in _NAMED and name:
            yield name


def anonymous(line: str, keep: set[str], person: Person) -> str:
    """Return a line without quoted names and paths. keep: names of sinks, which stay."""
    line = _QUOTED.sub(lambda found: found[0] if found[0][1:-1] in keep else HIDDEN, line)
    line = _PATH.sub(_shown_path, line)
    for name in (person.home, person.host, person.user):
        if name not in ("", "/", "root", "localhost"):
            line = re.sub(rf"(?<!\w){re.escape(name)}(?!\w)", HIDDEN, line)
    return line


def _shown_path(found: re.Match[str]) -> str:
    path, _, rest = found[0].partition(" ")
    return found[0] if path.startswith(_SYSTEM) and "/" not in rest else HIDDEN


def _rows(facts: Facts) -> Iterator[tuple[str, str]]:
    system, server, plugin, config = facts.system, facts.server, facts.plugin, facts.config
    yield "cushion", f"{system.program}, Python {system.python}"
    yield "system", f"{system.distribution}, {system.kernel}" + ", as root" * system.is_root
    rtkit = {True: "present", False: "missing", None: "unknown"}[system.rtkit]
    priority = system.priority or "none"
    yield "priority", f"{priority}; RLIMIT_RTPRIO {system.rtprio_limit}; rtkit {rtkit}"
    yield "PipeWire", f"{system.pipewire or 'none'}, WirePlumber {system.wireplumber or 'none'}"
    yield "server", f"{server.kind} {server.version}" if server.kind else f"none: {server.error}"
    if (graph := server.graph) is not None:
        forced = f" (forced to {graph.forced_hz} Hz)" * bool(graph.forced_hz)
        cycle = f" (forced to {graph.forced_frames})" * bool(graph.forced_frames)
        allowed = ", ".join(map(str, graph.allowed_hz))
        yield (
            "graph",
            f"{graph.rate_hz} Hz{forced}, allowed {allowed} Hz; quantum "
            + (f"{graph.quantum_frames} frames{cycle}"),
        )
    for sink in server.sinks:
        yield "sink", _sink_text(sink, facts)
    for link in graph.links if graph else ():
        yield "link", link
    yield "players", ", ".join(server.players)
    yield "config", config.error or f"tap {config.tap}, device {config.device or 'none'}"
    for folder in facts.folders:
        free = "" if folder.free_bytes is None else f"{folder.free_bytes / 2**20:.1f} MB free"
        yield f"{folder.what} folder", folder.problem or free
    built = "built" if plugin.built else "missing"
    yield "plugin", f"{built}; installed copy: {plugin.installed or 'none'}"
    yield from _daemon_rows(facts)
    if (delay := facts.delay) is not None:
        found = (
            f"median of {delay.bursts} bursts; the true delay is up to {delay.cycle_ms:.1f} ms more"
        )
        known = delay.delay_ms is not None
        yield "measured delay", f"{delay.delay_ms:.1f} ms ({found})" if known else delay.reason


def _sink_text(sink: SinkFacts, facts: Facts) -> str:
    volume = "0 %" if sink.volume_db is None else f"{sink.volume_db:+.1f} dB"
    parts = (
        f"{sink.name}: {sink.samplerate} Hz, {sink.channels} channels, {volume}",
        "muted" * sink.muted,
        sink.state,
        "default" * (sink.name == facts.server.default_sink),
        "plays the sound" * (sink.name == facts.heard),
        "plays the vibration" * (sink.name == facts.felt),
        f"declares {sink.declared_ms:.1f} ms" if sink.declared_ms else "declares no delay",
    )
    return ", ".join(filter(None, parts))


def _daemon_rows(facts: Facts) -> Iterator[tuple[str, str]]:
    status = facts.daemon.status
    if status is None:
        yield "daemon", facts.daemon.error or "none"
        return
    yield "daemon", f"{status.version}, {status.state.value} for {status.since_s:.0f} s"
    yield "reason", status.reason
    yield "engine", f"{status.engine} {status.engine_reason}".rstrip()
    yield "profile", status.profile
    if status.graph is not None and status.graph.samplerate:
        graph = status.graph
        yield "cycle", f"{graph.cycle_frames} frames at {graph.samplerate} Hz, tap {graph.tap}"
    yield "status delay", f"{status.latency.total_ms:.1f} ms"
    yield "offset", f"{status.offset_ms:.1f} ms, {status.offset_reason}"
    counts = ((cause.value, count) for cause, count in status.recoveries.items() if count)
    yield "recoveries", ", ".join(f"{cause} {count}" for cause, count in counts)
    yield "dropouts", f"tap {status.xruns.tap}, output {status.xruns.output}"
    levels = status.levels
    peaks = f"sound {levels.sound.peak_dbfs:.0f}, vibration {levels.vibration.peak_dbfs:.0f} dBFS"
    yield "peak levels", peaks
    for warning in status.warnings:
        yield "warning", warning
