"""Findings and facts as text, and the removal of personal names from a text. No I/O."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from audioflinger_hook.doctor.checks import TEXTS, Finding
from audioflinger_hook.doctor.facts import OURS, Facts
from audioflinger_hook.service.status import status_rows
from device.server.graph import Graph

# Rows of the status that never contain a name of an application, a file or an actuator.
_STATUS_ROWS = "cushion state profile server latency offset dropouts recoveries sound vibration"
# Paths outside these folders may be names that the user gave.
_SYSTEM = ("/usr/", "/etc/", "/proc/", "/dev/", "/lib")
_QUOTED = re.compile(r"(?<!\w)(['\"]).*?\1(?!\w)")  # "PipeWire's" has an apostrophe, no quote
# A path may contain spaces, so everything up to the next clause counts as its name.
_PATH = re.compile(r"(?<![\w.~/])(?:(?:app|file|capture|wav):(?=\S)|[~.]{0,2}/)[^;:,)'\"]*")
_PLAIN = re.compile(r"[-+.\w]{0,2}|[-+.\deE_]+|true|false")  # values that are no names
_OWN_WORDS = str(TEXTS)  # a name that these texts contain, such as "PipeWire", tells nothing
HIDDEN = "(hidden)"


def findings_text(findings: Sequence[Finding], repairs: Sequence[str]) -> str:
    """Return all findings, numbered, each with its advice, and the repairs."""
    lines = [] if findings else ["Nothing is wrong."]
    for number, finding in enumerate(findings, 1):
        lines += [f"{number}. {finding.wrong}", f"   {finding.advice}"]
        lines += [f"       {finding.command}"] * bool(finding.command)
    lines += [f"repaired: {done}" for done in repairs]
    return "\n".join(lines)


def facts_text(facts: Facts) -> str:
    """Return all facts, one for each line."""
    return "\n".join(f"{label + ':':<20}{text}" for label, text in rows(facts))


def full_report(
    facts: Facts, findings: Sequence[Finding], repairs: Sequence[str], person: Sequence[str]
) -> str:
    """Return findings and facts without names of files, windows, streams and the person.

    person: names of the user, of the home folder and of the machine.
    """
    keep = {sink.name for sink in facts.server.sinks} if facts.server else set()
    text = f"{findings_text(findings, repairs)}\n\n{facts_text(facts)}\n"
    for word in sorted({*_private_words(facts)} - keep, key=len, reverse=True):
        text = re.sub(rf"(?<![^\W_]){re.escape(word)}(?![^\W_])", HIDDEN, text)
    return "\n".join(anonymous(line, keep, person) for line in text.split("\n"))


def _private_words(facts: Facts) -> Iterator[str]:
    """Return the user's own words: values in the config file, and names of streams."""
    for mistake in facts.mistakes:
        value = mistake.value.strip('"')
        if not _PLAIN.fullmatch(value):
            yield value
        if "is not TOML" in mistake.problem:
            yield mistake.key  # the text of the line
    status, server = facts.status, facts.server
    used = [status.tap.address, status.device.address] if status else []
    for address in (*facts.live.tap, facts.live.device or "", *used):
        kind, _, name = address.partition(":")
        if kind in ("app", "file", "capture", "wav") and name:
            yield name
    names = [one.name for one in status.applications] if status else []
    for one in server.sink_inputs if server else ():
        names += [one.application, one.media]
    yield from (name for name in names if name not in _OWN_WORDS)


def anonymous(line: str, keep: set[str], person: Sequence[str]) -> str:
    """Return a line without quoted names and paths. keep: names of sinks, which stay."""
    line = _QUOTED.sub(lambda found: found[0] if found[0][1:-1] in keep else HIDDEN, line)
    line = _PATH.sub(_shown_path, line)
    for name in sorted(person, key=len, reverse=True):
        if name not in ("", "/", "root", "localhost"):
            line = re.sub(rf"(?<!\w){re.escape(name)}(?!\w)", HIDDEN, line)
    return line


def _shown_path(found: re.Match[str]) -> str:
    path, _, rest = found[0].partition(" ")
    return found[0] if path.startswith(_SYSTEM) and "/" not in rest else HIDDEN


def rows(facts: Facts) -> Iterator[tuple[str, str]]:
    """Return label and text of each fact. They name no streams, windows or applications."""
    server, graph, delay = facts.server, facts.graph, facts.delay
    yield "cushion", facts.program
    yield "system", facts.system + ", as root" * facts.is_root
    rtkit = {True: "present", False: "missing", None: "unknown"}[facts.rtkit]
    limit = f"RLIMIT_RTPRIO {facts.rtprio_limit}"
    yield "real-time", f"{'yes' if facts.is_realtime else 'no'}; {limit}; rtkit {rtkit}"
    yield "PipeWire", f"{facts.pipewire or 'none'}, WirePlumber {facts.wireplumber or 'none'}"
    yield "server", f"{server.kind} {server.version}" if server else f"none: {facts.server_error}"
    if graph is not None:
        yield "graph", ", ".join(f"{key} {value}" for key, value in graph.settings.items())
    yield from (("sink", text) for text in _sinks(facts))
    yield from (("link", text) for text in (_links(graph) if graph else ()))
    yield "players", ", ".join(facts.players) or "none"
    chosen = f"tap {facts.live.tap[0]}, device {facts.live.device or 'none'}"
    yield "config", facts.config_error or chosen
    for folder in facts.folders:
        yield f"{folder.what} folder", folder.problem or f"{folder.free_bytes / 2**20:.1f} MB free"
    built = "built" if facts.is_built else "missing"
    yield "plugin", f"{built}; installed copy: {facts.installed or 'none'}"
    if (status := facts.status) is None:
        yield "daemon", facts.daemon_error or "none"
    else:
        for row in status_rows(replace(status, reason="")):  # a finding has the complete reason
            if row.label in _STATUS_ROWS.split():
                yield f"daemon {row.label}", str(row)
        yield "daemon engine", ": ".join(filter(None, (status.engine, status.engine_reason)))
    yield from (("last error", text) for text in facts.errors)
    if delay is not None and delay.delay_ms is None:
        yield "measured delay", delay.reason
    elif delay is not None:
        more = "; the true delay is up to one cycle more" if graph else ""
        yield "measured delay", f"{delay.delay_ms:.1f} ms (median of {delay.bursts} bursts{more})"


def _sinks(facts: Facts) -> Iterator[str]:
    server, graph = facts.server, facts.graph
    cycle_frames, *_ = *facts.clock("force-quantum"), *facts.clock("quantum"), 0
    for sink in server.sinks if server else ():
        node = graph.sink(sink.name) if graph else None
        declared_s = facts.latencies_s.get(sink.name)
        if graph is not None:  # a delay in cycles counts as cycles of the configured quantum
            declared_s = graph.declared_s(sink.name, cycle_frames, graph.clock_hz)
        parts = (
            f"{sink.name}: {sink.samplerate} Hz, {sink.channels} channels",
            f"volume {sink.volume_percent} %",
            "muted" * sink.mute,
            node.state if node else "",
            "default" * (server is not None and sink.name == server.default_sink),
            "plays the sound" * (sink == facts.heard),
            "plays the vibration" * (sink == facts.felt),
            f"declares {1e3 * declared_s:.1f} ms" if declared_s else "declares no delay",
        )
        yield ", ".join(filter(None, parts))


def _links(graph: Graph) -> list[str]:
    """Return the links of the tap and the vibration, as "FROM -> TO (STATE) x CHANNELS"."""
    names = {
        node.id: node.name if node.is_sink or re.fullmatch(OURS, node.name) else f"stream {node.id}"
        for node in graph.nodes.values()
    }
    texts = (
        f"{names.get(one.output_node_id)} -> {names.get(one.input_node_id)} ({one.state})"
        for one in sorted(graph.links.values(), key=lambda link: link.id)
    )
    found = Counter(text for text in texts if re.search(OURS, text))
    return [f"{text} x {count}" for text, count in found.items()]
