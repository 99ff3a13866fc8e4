"""A private sound server: tools/sound_server.py pulse|pipewire [COMMAND ...].

The program starts PulseAudio, or PipeWire with WirePlumber and pipewire-pulse, in a private folder.
The server has two null sinks, `desktop` (the default) and `haptic`. The program runs the command
(default: a shell) in an environment that selects this server, then stops the server. The server
uses no session bus and no hardware, and writes only into its folder, so a desktop's own server is
not affected.

With --clock-ratio 1.0002, the clock of PulseAudio and its sinks is 200 ppm fast, as the clock of
another sound card may be. The tests use `SoundServer` directly. tools/fetch_servers.sh installs the
servers.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tools.sound_server_files import (
    RATE_HZ,
    pulseaudio_options,
    wireplumber_command,
    wireplumber_generation,
    write_configuration,
)

PROGRAMS = {
    "pulse": ("pulseaudio", "pactl", "pacat"),
    "pipewire": ("pipewire", "wireplumber", "pipewire-pulse", "pactl", "pacat", "pw-play"),
}
FAKETIME = "libfaketime.so.1"  # a library that changes the speed of a program's clock
STEREO = "front-left,front-right"
MONO = "mono"
SURROUND_5_1 = "front-left,front-right,front-center,lfe,rear-left,rear-right"
START_S = 15.0  # time in s within which a server must answer
_FOREIGN = ("PULSE_", "PIPEWIRE_", "WIREPLUMBER_", "XDG_", "DBUS_", "ALSA_", "JACK_", "DISPLAY")


class ServerError(Exception):
    """The server is not installed, does not start or does not answer."""


def missing_programs(kind: str) -> list[str]:
    """Return the names of missing programs and configurations that a server of this kind needs."""
    missing = [program for program in PROGRAMS[kind] if shutil.which(program) is None]
    if kind == "pipewire" and wireplumber_generation() is None:
        missing.append("a configuration of WirePlumber (/usr/share/wireplumber)")
    return missing


def missing_clock() -> list[str]:
    """Return the library that `clock_ratio` needs, if it is missing."""
    return [] if _faketime() else [FAKETIME]


class SoundServer:
    """A running server of kind `pulse` or `pipewire` in `folder`, until the end of the context.

    address: value of PULSE_SERVER. environment: for programs that use this server. clock_ratio:
    speed of the server's clock relative to the system clock, 0.99 to 1.01; PulseAudio only. Only
    one thread may use it. Methods raise ServerError if the server fails or does not answer.
    """

    def __init__(self, kind: str, folder: Path, *, clock_ratio: float = 1.0) -> None:
        if missing := missing_programs(kind):
            raise ServerError(f"missing: {', '.join(missing)}; run tools/fetch_servers.sh")
        self._clock = _clock_environment(kind, clock_ratio)
        self.kind = kind
        self.folder = folder.resolve()
        socket = self.folder / "native"
        if len(bytes(socket)) > 100:
            raise ServerError(f"{socket} is too long for a socket's path; choose a shorter folder")
        self.address = f"unix:{socket}"
        self._socket = socket
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._modules: dict[str, str] = {}
        for name in ("", "home", "config", "state", "cache"):
            (self.folder / name).mkdir(mode=0o700, parents=True, exist_ok=True)
        self.environment = {
            name: value for name, value in os.environ.items() if not name.startswith(_FOREIGN)
        } | {
            "HOME": str(self.folder / "home"),
            "XDG_RUNTIME_DIR": str(self.folder),
            "XDG_CONFIG_HOME": str(self.folder / "config"),
            "XDG_STATE_HOME": str(self.folder / "state"),
            "XDG_CACHE_HOME": str(self.folder / "cache"),
            "DBUS_SESSION_BUS_ADDRESS": "disabled:",
            "PULSE_RUNTIME_PATH": str(self.folder / "pulse"),
            "PULSE_STATE_PATH": str(self.folder / "state" / "pulse"),
            "PULSE_COOKIE": str(self.folder / "cookie"),
            "PULSE_SERVER": self.address,
            "PIPEWIRE_RUNTIME_DIR": str(self.folder),
        }
        self._configuration = write_configuration(kind, self.folder, socket)
        self.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *details: object) -> None:
        self.stop()

    # ------------------------------------------------------------------------ start and stop

    def start(self) -> None:
        """Start the server and wait for both sinks. The server must not be running."""
        self._modules.clear()
        for leftover in ("native", "native.lock"):
            (self.folder / leftover).unlink(missing_ok=True)
        try:
            if self.kind == "pulse":
                self._run("pulseaudio", *pulseaudio_options(self.folder))
            else:
                self._run_pipewire()
                self._run("pipewire-pulse")
            self._add_first_sinks()
        except ServerError:
            self.stop()
            raise

    def kill(self) -> None:
        """End all processes of the server with SIGKILL, to simulate a crash."""
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        """End the server, if it is running."""
        self._end(signal.SIGTERM)

    def restart_wireplumber(self) -> None:
        """Simulate a crash of WirePlumber alone: kill it, restart it and wait for both sinks.

        Both sinks are replaced too. A crash has the same effect on the sinks of a sound card, which
        belong to WirePlumber.
        """
        self._end(signal.SIGKILL, "wireplumber")
        for name in ("desktop", "haptic"):
            self.remove(name)
        self._run(*wireplumber_command())
        self._add_first_sinks()

    def restart_pipewire(self) -> None:
        """Simulate a crash of PipeWire alone: kill it, restart it and wait for both sinks.

        WirePlumber ends with PipeWire and is restarted too; pipewire-pulse continues to run.
        """
        self._end(signal.SIGKILL, "wireplumber", "pipewire")
        self._modules.clear()
        self._run_pipewire()
        self._add_first_sinks()

    def pause(self) -> None:
        """Stop all processes by SIGSTOP: connections stay open, and nothing answers."""
        for process in self._processes.values():
            process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Resume a paused server."""
        for process in self._processes.values():
            process.send_signal(signal.SIGCONT)

    # ------------------------------------------------------------------------- sinks and sources

    def pactl(self, *arguments: str) -> str:
        """Return the output of pactl for these arguments, without the final newline."""
        return self._ask("pactl", *arguments)

    def add_sink(
        self, name: str, properties: str = "", *, rate_hz: int = RATE_HZ, channel_map: str = STEREO
    ) -> None:
        """Add a null sink with float32 samples (on PulseAudio without rewinds)."""
        arguments = [
            f"sink_name={name}",
            f"rate={rate_hz}",
            f"channels={channel_map.count(',') + 1}",
            f"channel_map={channel_map}",
            "format=float32le",
            f'sink_properties="device.description={name} {properties}"',
        ]
        if self.kind == "pulse":
            arguments.append("norewinds=1")
        self._modules[name] = self.pactl("load-module", "module-null-sink", *arguments)
        self._wait(lambda: name in self.names("sinks"), f"the sink {name}")

    def add_reference(self, name: str) -> None:
        """Add a null sink that does not drive PipeWire's graph while the sink `desktop` exists.

        The monitor of a sink that drives the graph is read one cycle late. The monitor of the new
        sink is read in the same cycle. If a player is also linked to the new sink, the new sink's
        monitor thus shows the time of the player's sound.
        """
        self.add_sink(
            name, "node.driver=false"
        )  # ignored by PipeWire 0.3, which chooses the older sink

    def add_microphone(self, name: str) -> None:
        """Add a source that is not a monitor, and make it the default source.

        The signal of the source NAME is the sound that is played to the sink NAME-room.
        """
        self.add_sink(f"{name}-room")
        arguments = [f"master={name}-room.monitor", f"source_name={name}", "channels=2"]
        self._modules[name] = self.pactl("load-module", "module-remap-source", *arguments)
        self._wait(lambda: name in self.names("sources"), f"the source {name}")
        self.pactl("set-default-source", name)
        self._wait(lambda: self.pactl("get-default-source") == name, "the default source")

    def choose_default(self, sink: str) -> None:
        """Make a sink the default, and wait until the server confirms it."""

        def chosen() -> bool:
            with contextlib.suppress(ServerError):
                self.pactl("set-default-sink", sink)
                return self.pactl("get-default-sink") == sink
            return False

        self._wait(chosen, f"default sink {sink}")

    def remove(self, name: str) -> None:
        """Remove a sink or source that this object has added, as if it were unplugged."""
        self.pactl("unload-module", self._modules.pop(name))

    def names(self, what: str) -> list[str]:
        """Return the names of all sinks or sources. what: `sinks` or `sources`."""
        lines = self.pactl("list", "short", what).splitlines()
        return [line.split("\t")[1] for line in lines]

    def set_clock(self, setting: str, value: int) -> None:
        """Set PipeWire's clock.SETTING, such as `force-quantum` in frames or `force-rate` in Hz."""
        self._ask("pw-metadata", "-n", "settings", "0", f"clock.{setting}", str(value))

    # ------------------------------------------------------------------------------- internals

    def _ask(self, *command: str) -> str:
        try:
            done = subprocess.run(
                command,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                timeout=START_S,
            )
        except subprocess.TimeoutExpired:
            raise ServerError(f"{' '.join(command)}: no answer") from None
        if done.returncode != 0:
            raise ServerError(f"{' '.join(command)}: {done.stderr.strip()}")
        return done.stdout.strip()

    def _run_pipewire(self) -> None:
        for leftover in ("pipewire-0", "pipewire-0.lock"):
            (self.folder / leftover).unlink(missing_ok=True)
        self._run("pipewire")
        self._wait(lambda: (self.folder / "pipewire-0").exists(), "PipeWire's socket")
        self._run(*wireplumber_command())

    def _add_first_sinks(self) -> None:
        self._wait(self._answers, "an answer")
        self.add_sink("desktop")
        self.add_sink("haptic")
        self.choose_default("desktop")

    def _run(self, *command: str) -> None:
        # `setpriv` ends the server when its parent process ends or is killed.
        bound = ("setpriv", "--pdeathsig", "TERM") if shutil.which("setpriv") else ()
        with (self.folder / f"{command[0]}.log").open("ab") as log:
            self._processes[command[0]] = subprocess.Popen(
                (*bound, *command),
                env=self.environment | self._configuration | self._clock,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    def _end(self, how: signal.Signals, *programs: str) -> None:
        names = programs or tuple(reversed(self._processes))
        ending = [self._processes.pop(name) for name in names if name in self._processes]
        for process in ending:
            process.send_signal(signal.SIGCONT)
            process.send_signal(how)
        for process in ending:
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _answers(self) -> bool:
        with contextlib.suppress(ServerError):
            return self._socket.exists() and bool(self.pactl("info"))
        return False

    def _wait(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + START_S
        while not condition():
            dead = [one for one in self._processes.values() if one.poll() is not None]
            if dead or time.monotonic() > deadline:
                logs = [log.read_text("utf-8", "replace") for log in self.folder.glob("*.log")]
                ended = "".join(f"{process.args!r} ended; " for process in dead)
                raise ServerError(f"{self.kind}: no {what}; {ended}{''.join(logs)[-2000:]}")
            time.sleep(0.005)


def _faketime() -> Path | None:
    return next(Path("/usr/lib").glob(f"*/faketime/{FAKETIME}"), None)


def _clock_environment(kind: str, ratio: float) -> dict[str, str]:
    if ratio == 1.0:
        return {}
    if kind != "pulse" or not 0.99 <= ratio <= 1.01:
        raise ServerError(
            f"clock_ratio={ratio:g} of {kind} is not possible; 0.99 to 1.01 of pulse are"
        )
    library = _faketime()
    if library is None:
        raise ServerError(f"missing: {FAKETIME}; run tools/fetch_servers.sh")
    return {"LD_PRELOAD": str(library), "FAKETIME": f"+0 x{ratio:.9f}"}


def main() -> int:
    """Run a command with a private server; return its exit code, or 1 if the server fails."""
    parser = argparse.ArgumentParser(description="Run a command beside a private sound server.")
    parser.add_argument("kind", choices=sorted(PROGRAMS))
    parser.add_argument(
        "--clock-ratio", type=float, default=1.0, metavar="X", help="pulse: relative clock speed"
    )
    parser.add_argument("command", nargs=argparse.REMAINDER, help="default: a shell")
    options = parser.parse_args()
    command = options.command or [os.environ.get("SHELL", "/bin/sh")]
    with tempfile.TemporaryDirectory(prefix="sound-server-") as folder:
        try:
            with SoundServer(options.kind, Path(folder), clock_ratio=options.clock_ratio) as server:
                return subprocess.run(command, env=server.environment).returncode
        except ServerError as error:
            print(f"sound_server: error: {error}", file=sys.stderr)
            return 1


if __name__ == "__main__":
    sys.exit(main())
