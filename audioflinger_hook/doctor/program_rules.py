"""Rules about permission, daemon, plugin, folders and config: facts become findings. No I/O."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from audioflinger_hook.doctor.facts import Facts
from audioflinger_hook.doctor.finding import Finding
from audioflinger_hook.service.state import READY

FREE_MIN_BYTES = 1 << 20  # state, lock and socket need some kilobytes


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
        unmute = "Switch the vibration on in the live page."
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
