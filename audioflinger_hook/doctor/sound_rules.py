"""Rules about the sound server, its outputs and the device: facts become findings. No I/O."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from audioflinger_hook.doctor.facts import Facts, SinkFacts
from audioflinger_hook.doctor.finding import Finding

WEAK_DB = -20.0  # the server's 46 %: vibration is a tenth as strong


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


def delay(facts: Facts) -> Iterator[Finding]:
    """Bursts that were played must have been felt."""
    if facts.delay is not None and facts.delay.was_played and facts.delay.delay_ms is None:
        yield Finding(
            "not-felt",
            f"A measurement played bursts, but their delay is unknown: {facts.delay.reason}.",
            "See which level is missing.",
            "cushion status --watch",
        )


def _volume(sink: SinkFacts) -> str:
    if sink.volume_db is None:
        return "volume 0 %"
    return f"volume {round(100.0 * 10.0 ** (sink.volume_db / 60.0))} %"
