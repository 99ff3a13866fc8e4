"""Rules that turn facts into findings: what is wrong, which value, what to do. No I/O."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from audioflinger_hook.doctor.facts import Facts, SinkFacts
from audioflinger_hook.service.state import READY

FREE_MIN_BYTES = 1 << 20  # state, lock and socket need some kilobytes
WEAK_DB = -20.0  # the server's 46 %: vibration is a tenth as strong


@dataclass(frozen=True)
class Finding:
    """Something that is wrong.

    name: of the rule. wrong: what is wrong, in one sentence with the value. advice: what to do.
    command: to type, "" for none. repair: name of the repair of `--fix`, "" for none.
    """

    name: str
    wrong: str
    advice: str
    command: str = ""
    repair: str = ""


Rule = Callable[[Facts], Iterator[Finding]]


def find(facts: Facts) -> list[Finding]:
    """Return all findings, causes before their effects."""
    return [finding for rule in RULES for finding in rule(facts)]


def server_answers(facts: Facts) -> Iterator[Finding]:
    """A sound server must answer, and PipeWire needs pipewire-pulse and a session manager."""
    server, graph = facts.server, facts.server.graph
    if not server.kind and server.hangs:
        yield Finding(
            "server-hangs",
            "The sound server accepts connections, but does not answer.",
            "Restart the sound server.",
            "systemctl --user restart pipewire pipewire-pulse wireplumber",
        )
    elif not server.kind and graph is not None:
        yield Finding(
            "no-pulse",
            f"PipeWire {graph.version} runs, but pipewire-pulse does not answer: {server.error}.",
            "Start pipewire-pulse.",
            "systemctl --user start pipewire-pulse",
        )
    elif not server.kind:
        as_user = " Run cushion as the user of the desktop, not as root." * facts.system.is_root
        yield Finding(
            "no-server",
            f"There is no sound server: {server.error}.",
            f"Start the sound server.{as_user}",
            "systemctl --user start pipewire pipewire-pulse wireplumber",
        )
    if graph is not None and not graph.has_session_manager:
        yield Finding(
            "no-session-manager",
            "PipeWire has no session manager, so nothing links programs to outputs.",
            "Start WirePlumber.",
            "systemctl --user start wireplumber",
        )


def server_is_pipewire(facts: Facts) -> Iterator[Finding]:
    """The native engine needs PipeWire; on PulseAudio, vibration comes late."""
    if facts.server.kind == "PulseAudio":
        yield Finding(
            "pulseaudio",
            f"The sound server is PulseAudio {facts.server.version}, so only the Python engine can "
            "play: vibration comes 65 to 130 ms after its sound.",
            "Install pipewire, pipewire-pulse and wireplumber in place of PulseAudio, or delay the "
            "sound too, in drop-in mode.",
            "cushion run --drop-in --offset-ms=-69",
        )


def default_sink(facts: Facts) -> Iterator[Finding]:
    """The default sink must exist, and must not be the sink of the vibration."""
    server, felt = facts.server, facts.felt
    if not server.kind:
        return
    others = [sink.name for sink in server.sinks if sink.name != felt]
    command = f"pactl set-default-sink {shlex.quote(others[0]) if len(others) == 1 else 'NAME'}"
    if felt and server.default_sink == felt:
        yield Finding(
            "wrong-default-sink",
            f"The default output {felt!r} is the output of the vibration, so all programs play "
            "their sound on the actuators.",
            "Make your speakers the default output.",
            command,
        )
    elif not server.default_sink:
        yield Finding(
            "no-default-sink",
            "The sound server has no default output, so there is no sound to capture.",
            "Connect your speakers, or choose the default output.",
            command,
        )


def device(facts: Facts) -> Iterator[Finding]:
    """A device for the vibration must be chosen and present."""
    config = facts.config
    if facts.daemon.status is not None or config.error or config.mistakes:
        return
    if config.device_error:
        yield Finding(
            "no-device",
            f"The device of the vibration is missing: {config.device_error}.",
            "Connect the device, or choose another one.",
            "cushion devices",
        )
    elif not config.device:
        yield Finding(
            "no-device-chosen",
            "No device is chosen for the vibration: the config file names none.",
            "Choose the device.",
            "cushion setup",
        )


def levels(facts: Facts) -> Iterator[Finding]:
    """The sinks of sound and vibration must not be muted, nor the vibration's be very low."""
    felt, heard = facts.server.sink(facts.felt), facts.server.sink(facts.heard)
    if felt is not None:
        name = shlex.quote(felt.name)
        if felt.muted:
            yield Finding(
                "device-muted",
                f"The output of the vibration {felt.name!r} is muted, at {_volume(felt)}.",
                "Turn the amplifier down, then unmute the output.",
                f"pactl set-sink-mute {name} 0",
                "unmute",
            )
        elif felt.volume_db is None or felt.volume_db < WEAK_DB:
            yield Finding(
                "device-low",
                f"The output of the vibration {felt.name!r} is at {_volume(felt)}.",
                "Turn the amplifier down, then set the volume to 100 %.",
                f"pactl set-sink-volume {name} 100%",
            )
    if heard is not None and heard.muted and heard != felt:
        yield Finding(
            "sound-muted",
            f"The output of the sound {heard.name!r} is muted, so nothing is felt.",
            "Unmute the output, and set a low volume instead.",
            f"pactl set-sink-mute {shlex.quote(heard.name)} 0",
        )


def rates(facts: Facts) -> Iterator[Finding]:
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
        runs = "is forced to" if graph.forced_hz else "runs at"
        if graph.forced_hz:
            advice, rate_hz = "End the forced rate.", 0
        elif len(used_hz) == 1:
            advice, rate_hz = "Let the graph run at the rate of the output.", sink.samplerate
        else:
            advice, rate_hz = "Give both outputs this rate in their configuration.", None
        yield Finding(
            "rate-clash",
            f"The output {sink.name!r} runs at {sink.samplerate} Hz, but PipeWire's graph {runs} "
            f"{graph.clock_hz} Hz.",
            advice,
            "" if rate_hz is None else f"pw-metadata -n settings 0 clock.force-rate {rate_hz}",
        )


def priority(facts: Facts) -> Iterator[Finding]:
    """Audio threads need real-time priority, by a limit of the system or by rtkit."""
    system = facts.system
    if system.priority == "real-time" or system.rtkit:
        return
    asked = "the system bus cannot be asked" if system.rtkit is None else "it is not on the bus"
    yield Finding(
        "no-realtime",
        f"Audio threads get no real-time priority: RLIMIT_RTPRIO is {system.rtprio_limit}, and "
        f"rtkit is missing ({asked}).",
        "Install rtkit, or allow real-time priority with this command and log in again.",
        'echo "$USER - rtprio 20" | sudo tee /etc/security/limits.d/cushion.conf',
    )


def one_daemon(facts: Facts) -> Iterator[Finding]:
    """One daemon plays; it answers, and the lock names a living process."""
    daemon, players, holder = facts.daemon, facts.server.players, facts.daemon.holder
    if len(players) > 1:
        known = f"process {daemon.status.pid}" if daemon.status else ""
        other = next(player for player in reversed(players) if player != known)
        process = other.removeprefix("process ")
        yield Finding(
            "second-daemon",
            f"{len(players)} programs play vibration to this server: {', '.join(players)}.",
            "End all but one of them.",
            f"kill {process}" if process != other else "cushion plugin remove",
        )
    if daemon.status is None and daemon.is_locked:
        who = f"process {holder.pid}" if holder else "an unknown process"
        yield Finding(
            "daemon-hangs",
            f"A daemon ({who}) holds the lock, but gives no status: {daemon.error or 'no answer'}.",
            "End this daemon, then start it again.",
            f"kill -9 {holder.pid}" if holder else "",
        )
    elif daemon.error:
        yield Finding(
            "daemon-silent", f"The daemon gives no status: {daemon.error}.", "Start it again."
        )
    elif daemon.status is None and holder is not None:
        yield Finding(
            "stale-lock",
            f"The last daemon (process {holder.pid}, started {holder.started}) was killed or "
            "crashed: its lock file remains.",
            "Remove the file with `cushion doctor --fix`, and start the daemon again.",
            "journalctl --user -u cushion",
            "lock",
        )
    if daemon.service == "failed":
        other = ", because another daemon runs" * (daemon.status is not None)
        yield Finding(
            "service-failed",
            f"The service has failed{other}.",
            "Read its messages. If a daemon runs in a terminal, end it and start the service.",
            "journalctl --user -u cushion",
        )


def plugin(facts: Facts) -> Iterator[Finding]:
    """The compiled plugin must exist, and an installed copy must be the same."""
    found, needs_server = facts.plugin, facts.config.is_on_server
    if not found.built:
        yield Finding(
            "no-plugin",
            "The plugin is missing: the file haptic_cushion.so was not built.",
            "Install a C compiler, such as gcc, and build the plugin.",
            "make run",
        )
    elif facts.server.kind == "PipeWire" and found.native_problem and needs_server:
        wrong = f"The native engine cannot run: {found.native_problem}."
        yield Finding("no-native", wrong, "Until then, the slower Python engine plays.")
    if found.installed in ("missing", "other version"):
        state = "is missing" if found.installed == "missing" else "is of another version"
        yield Finding(
            "plugin-copy",
            f"The installed copy of the plugin {state}.",
            "Install it again.",
            "cushion plugin install",
            "plugin" if found.built else "",
        )
    if facts.server.kind == "PulseAudio" and found.alsa_problem and needs_server:
        wrong = f"The Python engine cannot play: {found.alsa_problem}."
        yield Finding("no-alsa-plugin", wrong, "Without it, nothing is felt on PulseAudio.")


def folders(facts: Facts) -> Iterator[Finding]:
    """The program's folders must be usable, and their disks must have space."""
    for folder in facts.folders:
        if folder.problem:
            yield Finding(
                f"{folder.what}-folder",
                f"The {folder.what} folder cannot be used: {folder.problem}.",
                "Make the folder usable for this user.",
                f"mkdir -m 700 {shlex.quote(folder.path)}" if folder.can_make else "",
                "folder" if folder.can_make else "",
            )
        elif folder.free_bytes is not None and folder.free_bytes < FREE_MIN_BYTES:
            yield Finding(
                "disk-full",
                f"The disk of the {folder.what} folder is full: "
                f"{folder.free_bytes // 1_024} kB are free at {folder.path}.",
                f"Delete some files; at least {FREE_MIN_BYTES // 1_024} kB are needed.",
                f"df -h {shlex.quote(folder.path)}",
            )


def config(facts: Facts) -> Iterator[Finding]:
    """The config file must have no mistakes."""
    if facts.config.error:
        wrong = f"The config file cannot be read: {facts.config.error}."
        yield Finding("config", wrong, "Correct the file.", "cushion check")
    for mistake in facts.config.mistakes:
        yield Finding(
            "config",
            f"The config file has a mistake: {mistake}.",
            "Correct the line.",
            "cushion check",
        )
    for warning in facts.config.warnings:
        wrong = f"The config file leads to a warning: {warning}."
        yield Finding("config", wrong, "See all mistakes and warnings.", "cushion check")


def daemon_state(facts: Facts) -> Iterator[Finding]:
    """A daemon must run, and report no trouble."""
    status = facts.daemon.status
    if status is None:
        if not facts.daemon.is_locked and not facts.daemon.error:
            start = "Start it, or install the service with `cushion install-service`."
            yield Finding("no-daemon", "No daemon is running.", start, "cushion run")
        return
    if status.version != facts.system.program:
        yield Finding(
            "daemon-version",
            f"The daemon has version {status.version}, and this command {facts.system.program}.",
            "Start the daemon again.",
            "systemctl --user restart cushion",
        )
    if status.state not in READY:
        reason = f": {status.reason}" * bool(status.reason)
        wrong = f"The daemon is {status.state.value}{reason}."
        yield Finding("daemon-waits", wrong, "Remove the cause; the daemon then continues.")
    if status.muted:
        unmute = "Press Unmute in the live page."
        yield Finding("muted", "The vibration is muted.", unmute, "cushion monitor --open")
    if (
        facts.server.kind == "PipeWire"
        and status.engine == "python"
        and facts.config.engine != "python"
        and not status.engine_reason.startswith("engine =")
    ):
        yield Finding(
            "python-engine",
            "The Python engine plays, so vibration comes 65 to 130 ms after its sound: "
            f"{status.engine_reason}.",
            "Remove the reason if possible.",
        )
    if status.graph is not None and status.graph.tap == "monitor":
        yield Finding(
            "monitor-tap",
            "The sound is read one cycle late, from the output's monitor: "
            f"{status.graph.tap_reason}.",
            "Set a shorter cycle.",
            "pw-metadata -n settings 0 clock.force-quantum 256",
        )
    for warning in status.warnings:
        yield Finding("daemon-warns", f"The daemon warns: {warning}.", "Follow this warning.")


def delay(facts: Facts) -> Iterator[Finding]:
    """Bursts that were played must have been felt."""
    if facts.delay is not None and facts.delay.was_played and facts.delay.delay_ms is None:
        yield Finding(
            "not-felt",
            f"A measurement played bursts, but their delay is unknown: {facts.delay.reason}.",
            "See which level is missing.",
            "cushion status --watch",
        )


RULES: tuple[Rule, ...] = (
    server_answers,
    server_is_pipewire,
    config,
    folders,
    plugin,
    default_sink,
    device,
    levels,
    rates,
    priority,
    one_daemon,
    daemon_state,
    delay,
)


def _volume(sink: SinkFacts) -> str:
    if sink.volume_db is None:
        return "volume 0 %"
    return f"volume {round(100.0 * 10.0 ** (sink.volume_db / 60.0))} %"
