"""Finds the faults of a set-up, from its facts. No I/O."""

import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from audioflinger_hook.doctor.facts import Facts
from audioflinger_hook.service.state import READY
from device.server.tap_volume import muted_sink

WEAK_DB = -20.0  # the server's 46 %: vibration is a tenth as strong
FREE_MIN_BYTES = 1 << 20  # state, lock and socket need some kilobytes

# Causes come before their effects. Each finding has its name and what is wrong, then what to do and
# perhaps a command. Texts whose names begin with the same word belong to one finding. Names in
# braces are facts, or values that the checks give.
_TABLE = """\
server-hangs: The sound server accepts connections, but does not answer.
    Restart the sound server.
    $ systemctl --user restart pipewire pipewire-pulse wireplumber
no-pulse: PipeWire {graph.version} runs, but pipewire-pulse does not answer: {server_error}.
    Start pipewire-pulse.
    $ systemctl --user start pipewire-pulse
no-server: There is no sound server: {server_error}.
    Start the sound server.{as_user}
    $ systemctl --user start pipewire pipewire-pulse wireplumber
no-session-manager: PipeWire has no session manager, so nothing links programs to outputs.
    Start WirePlumber.
    $ systemctl --user start wireplumber
pulseaudio: The sound server is PulseAudio {server.version}, so only the Python engine can play: \
vibration comes 65 to 130 ms after its sound.
    Install pipewire, pipewire-pulse and wireplumber in place of PulseAudio, or delay the sound \
too, in drop-in mode.
    $ cushion run --drop-in
config unreadable: The config file cannot be read: {config_error}.
    Correct the file.
    $ cushion check
config mistake: The config file has a mistake: {mistake}.
    Correct the line.
    $ cushion check
config warning: The config file leads to a warning: {warning}.
    See all mistakes and warnings.
    $ cushion check
folder: The {folder.what} folder cannot be used: {folder.problem}.
    Make the folder usable for this user; `cushion doctor --fix` makes a missing folder.
disk-full: The disk of the {folder.what} folder is full: {free_kb} kB are free at {folder.path}.
    Delete some files; at least {least_kb} kB are needed.
    $ df -h {word}
no-plugin: The plugin is missing: the file haptic_cushion.so was not built.
    Install a C compiler, such as gcc, and build the plugin.
    $ make run
no-native: The native engine cannot run: {native_problem}.
    Until then, the slower Python engine plays.
plugin-copy: The installed copy of the plugin is {installed}.
    Install it again.
    $ cushion plugin install
no-alsa-plugin: The Python engine cannot play: {alsa_problem}.
    Without it, no vibration plays on PulseAudio.
wrong-default-sink: The default output {felt.name!r} is the output of the vibration, so all \
programs play their sound on the actuators.
    Make your speakers the default output.
    $ pactl set-default-sink {speakers}
no-default-sink: The sound server has no default output, so no sound can be captured.
    Connect your speakers, or choose the default output.
    $ pactl set-default-sink {speakers}
no-tap: The tap {live.tap[0]!r} cannot be captured: {tap_error}.
    Correct `tap` in the config file, or remove it to capture the default output.
    $ cushion devices
no-device: The device of the vibration is missing: {device_error}.
    Connect the device, or choose another one.
    $ cushion devices
no-device-chosen: No device is chosen for the vibration: the config file names none.
    Choose the device.
    $ cushion setup
device-muted: The output of the vibration {felt.name!r} is muted, at volume {felt.volume_percent} %.
    Turn the amplifier down, then unmute the output.
    $ pactl set-sink-mute {felt_word} 0
device-low: The output of the vibration {felt.name!r} is at volume {felt.volume_percent} %.
    Turn the amplifier down, then set the volume to 100 %.
    $ pactl set-sink-volume {felt_word} 100%
sound-muted: The output of the sound {heard.name!r} is muted or at 0 %, so no vibration plays.
    Unmute the output, and set a low volume instead.
    $ pactl set-sink-mute {heard_word} 0
rate-clash forced: The output {sink.name!r} runs at {sink.samplerate} Hz, but PipeWire's graph is \
forced to {graph.clock_hz} Hz.
    End the forced rate.
    $ pw-metadata -n settings 0 clock.force-rate 0
rate-clash alone: The output {sink.name!r} runs at {sink.samplerate} Hz, but PipeWire's graph runs \
at {graph.clock_hz} Hz.
    Let the graph run at the rate of the output.
    $ pw-metadata -n settings 0 clock.force-rate {sink.samplerate}
rate-clash both: The output {sink.name!r} runs at {sink.samplerate} Hz, but PipeWire's graph runs \
at {graph.clock_hz} Hz.
    Give both outputs this rate in their configuration.
no-realtime: Audio threads get no real-time priority: RLIMIT_RTPRIO is {rtprio_limit}, and rtkit \
is missing ({asked}).
    Install rtkit, or allow real-time priority with this command and log in again.
    $ echo "$USER - rtprio 20" | sudo tee /etc/security/limits.d/cushion.conf
second-daemon: {count} programs play vibration to this server: {players}.
    End all but one of them.
    $ {command}
daemon-hangs: A daemon ({who}) holds the lock, but gives no status: {silent}.
    End this daemon, then start it again.
    $ {kill}
daemon-silent: The daemon gives no status: {daemon_error}.
    Start it again.
stale-lock: The last daemon (process {holder.pid}, started {holder.started}) was killed or \
crashed: its lock file remains.
    Remove the file with `cushion doctor --fix`, and start the daemon again.
    $ journalctl --user -u cushion
service-failed: The service has failed{other}.
    Read its messages. If a daemon runs in a terminal, end it and start the service.
    $ journalctl --user -u cushion
no-daemon: No daemon is running.
    Start it, or install the service with `cushion install-service`.
    $ cushion run
daemon-version: The daemon has version {status.version}, and this command {program}.
    Start the daemon again.
    $ systemctl --user restart cushion
daemon-waits: The daemon is {status.state.value}{waits}.
    Remove the cause; the daemon then continues.
muted: The vibration is muted.
    Switch the vibration on in the live page.
    $ cushion monitor --open
python-engine: The Python engine plays, so vibration comes 65 to 130 ms after its sound: \
{status.engine_reason}.
    Remove the reason if possible.
monitor-tap: The sound is read one cycle late, from the output's monitor: \
{status.graph.tap_reason}.
    Set a shorter cycle.
    $ pw-metadata -n settings 0 clock.force-quantum 256
daemon-warns remedy: The daemon warns: {warning}.
    {remedy}.
daemon-warns alone: The daemon warns: {warning}.
    Read the messages before this warning, in the daemon's terminal or with this command.
    $ journalctl --user -u cushion
not-felt: A measurement played bursts, but their delay is unknown: {delay.reason}.
    See which level is missing.
    $ cushion status --watch
"""

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
