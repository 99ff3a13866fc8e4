"""What the tests of `cushion run` share: the command as a process, its status, what comes out."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from audioflinger_hook.config.profiles import LIVE_DEFAULT, parameters_of
from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import Status
from audioflinger_hook.service.status_client import ask_status
from audioflinger_hook.transform.mapping import vibration_hz
from device.errors import CushionError
from device.units import Float32Array
from tests.servers.listening import RATE_HZ, playing, recording, wait_for, wait_seconds
from tests.support import commands
from tools.sound_server import SoundServer

CUSHION = (sys.executable, "-m", "audioflinger_hook")
ROOT = Path(__file__).parents[2]
SOUNDING = (DaemonState.RUNNING, DaemonState.IDLE)
FELT = 1e-3  # vibration of at least this is felt


class Daemon:
    """A running `cushion run`; stderr: what it has written there so far."""

    def __init__(self, server: SoundServer, process: Any) -> None:
        self._server = server
        self.process = process
        self.stderr = ""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stderr:
            self.stderr += line

    def status(self) -> Status | None:
        """What it says of itself, None while it does not answer."""
        try:
            return ask_status(2.0, time.monotonic, self._server.environment)
        except CushionError:
            return None

    def wait(self, condition: Callable[[Status], Any], what: str, limit_s: float = 15.0) -> Status:
        """Its status once the condition holds of it."""
        seen: list[Status] = []

        def holds() -> bool:
            assert self.process.poll() is None, f"{self.process.returncode}: {self.stderr}"
            status = self.status()
            if status is not None:
                seen[:] = [status]
            return status is not None and bool(condition(status))

        try:
            wait_for(holds, what, limit_s)
        except AssertionError as error:
            raise AssertionError(f"{error}; {seen} {self.stderr}") from None
        return seen[0]

    def wait_state(self, state: DaemonState, limit_s: float = 15.0) -> Status:
        return self.wait(lambda status: status.state is state, state.value, limit_s)

    def wait_ready(self, limit_s: float = 20.0) -> Status:
        """Its status once it plays and knows both clocks."""
        return self.wait(
            lambda status: (
                status.state in SOUNDING
                and (status.delay_line.delay_ms > 0.0 or status.engine == "native")
            ),
            "steady vibration",
            limit_s,
        )

    def engine_process(self) -> int:
        return self.wait(lambda status: status.engine_pid, "the native engine").engine_pid

    def reload(self, config: Path, text: str) -> None:
        """Let it read another config."""
        config.write_text(text)
        self.process.send_signal(signal.SIGHUP)

    def end(self, how: signal.Signals = signal.SIGTERM) -> int:
        self.process.send_signal(how)
        return self.wait_exit()

    def wait_exit(self, limit_s: float = 15.0) -> int:
        code: int = self.process.wait(limit_s)
        self.close()
        return code

    def close(self) -> None:
        """Read the rest of what it wrote, once it has ended."""
        self._reader.join(5.0)
        self.process.stderr.close()


@contextmanager
def running(
    server: SoundServer,
    *arguments: str,
    device: str | None = "haptic",
    engine: str | None = "python",
    ready: bool = True,
    within: Sequence[str] = (),
    variables: Mapping[str, str] = {},
) -> Iterator[Daemon]:
    """`cushion run` on this server, once it plays (unless not `ready`).

    device, engine: None for the config's; within: a command that runs it; variables: of its
    environment.
    """
    named = [] if device is None else ["--device", device]
    named += [] if engine is None else ["--engine", engine]
    process = subprocess.Popen(
        [*within, *CUSHION, "run", *named, *arguments],
        env=environment(server) | dict(variables),
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    daemon = Daemon(server, process)
    try:
        if ready:
            daemon.wait_ready()
        yield daemon
    finally:
        process.send_signal(signal.SIGCONT)
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        daemon.close()
        sys.stderr.write(daemon.stderr)


@contextmanager
def vibrating(server, folder, sound, *arguments, **options):
    """A daemon that vibrates while a sound plays to `desktop`, and a recording of what is felt.

    options: of `running`.
    """
    with (
        playing(server, "desktop", sound),
        running(server, *arguments, **options) as daemon,
        recording(server, "haptic.monitor", folder / "felt") as felt,
    ):
        wait_for(lambda: felt_now(felt), "vibration")
        yield daemon, felt


@contextmanager
def program(environ: Mapping[str, str], *command: str, **options: Any) -> Iterator[Any]:
    """A program that is killed at the end; what it writes goes to a pipe. options: of Popen."""
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE} | options
    with subprocess.Popen(command, env=dict(environ), cwd=ROOT, text=True, **pipes) as process:
        try:
            yield process
        finally:
            process.kill()


def cushion(server: SoundServer, *arguments: object, env: Any = None) -> commands.Done:
    return commands.cushion(*arguments, env=environment(server) | (env or {}))


def environment(server: SoundServer) -> dict[str, str]:
    return {**server.environment, "PYTHONPATH": str(ROOT)}


def configured(folder: Path, text: str) -> tuple[Path, tuple[str, str]]:
    """A config with this text, and the options that name it."""
    path = folder / "config.toml"
    path.write_text(text)
    return path, ("--config", str(path))


def tone(hz: float, seconds: float, level: float = 0.3) -> Float32Array:
    wave = level * np.sin(2.0 * np.pi * hz * np.arange(int(seconds * RATE_HZ)) / RATE_HZ)
    return np.column_stack([wave, wave]).astype(np.float32)


def felt_hz(hz: float) -> float:
    """The vibration of a tone with the default profile of `cushion run`."""
    return float(vibration_hz(np.array([hz]), parameters_of(LIVE_DEFAULT))[0])


def pitch_hz(frames: Float32Array) -> float:
    """The strongest frequency, to 1 Hz; 0 of silence."""
    if not len(frames) or float(np.abs(frames).max()) < FELT:
        return 0.0
    return float(np.argmax(np.abs(np.fft.rfft(frames[:, 0] * np.hanning(len(frames)), RATE_HZ))))


def envelope(samples: NDArray[np.floating]) -> NDArray[np.float64]:
    """The RMS over 10 ms, every millisecond."""
    step = RATE_HZ // 1_000
    squares = np.square(samples[: len(samples) // step * step], dtype=np.float64)
    return np.sqrt(np.convolve(squares.reshape(-1, step).mean(axis=1), np.full(10, 0.1), "valid"))


def best_lag(heard: NDArray[np.float64], wanted: NDArray[np.float64]) -> int:
    """By how many ms `wanted` comes late in `heard`."""
    if len(heard) <= len(wanted):
        return 0
    return int(np.argmax(correlate(heard, wanted, "valid")))


def nearest_lag(heard: NDArray[np.float64], wanted: NDArray[np.float64]) -> int:
    """By how many ms `wanted` comes late in `heard`, where both differ least.

    Products alone would choose the loudest place of a steady sound.
    """
    count = len(heard) - len(wanted) + 1
    if count <= 1:
        return 0
    windows = np.lib.stride_tricks.sliding_window_view(heard, len(wanted))
    return int(np.argmin(np.square(windows - wanted).sum(axis=1)))


def likeness(heard: NDArray[np.float64], wanted: NDArray[np.float64]) -> float:
    """The correlation of two envelopes, every second of them at its own best lag.

    A busy machine makes the daemon provide for more lateness meanwhile, which is no other sound.
    """
    lag, aligned = best_lag(heard, wanted), np.zeros_like(wanted)
    for start in range(0, len(wanted), 1_000):
        part = wanted[start : start + 1_000]
        near = heard[max(0, lag + start - 60) : lag + start + 60 + len(part)]
        own = nearest_lag(near, part)
        found = near[own : own + len(part)]
        aligned[start : start + len(found)] = found
    return float(np.corrcoef(aligned, wanted)[0, 1])


def felt_now(heard: Callable[[], Float32Array], seconds: float = 0.05) -> bool:
    last = heard()[-int(seconds * RATE_HZ) :]
    return bool(len(last)) and float(np.abs(last).max()) > FELT


def longest_silence(frames: Float32Array) -> int:
    """Frames of the longest run of exact zeros."""
    heard = np.flatnonzero(frames.any(axis=1))
    if not len(heard):
        return len(frames)
    return int(np.diff(np.concatenate([[-1], heard, [len(frames)]])).max()) - 1


def stream_named(server: SoundServer, name: str) -> str:
    """The index of the newest stream of an application."""

    def found() -> str:
        listed = server.pactl("list", "sink-inputs").split("Sink Input #")[1:]
        mine = [part.split()[0] for part in listed if f'application.name = "{name}"' in part]
        return mine[-1] if mine else ""

    return wait_for(found, f"a stream of {name}")


def links_of(server: SoundServer) -> str:
    """All links of PipeWire's graph, below each of their ports."""
    command = ("pw-link", "--links")
    return subprocess.run(
        command, env=server.environment, capture_output=True, text=True, check=True
    ).stdout


def modules_of(server: SoundServer) -> list[str]:
    return server.pactl("list", "short", "modules").splitlines()


def cpu_s(pid: int) -> float:
    return time.clock_gettime(~pid << 3 | 2)  # clock_getcpuclockid(3), which Python lacks


def cpu_percent(*pids: int, seconds: float = 4.0) -> list[float]:
    began_s, used_s = time.monotonic(), [cpu_s(pid) for pid in pids]
    wait_seconds(seconds)
    now_s, spent_s = time.monotonic(), [cpu_s(pid) for pid in pids]
    return [*(100.0 * np.subtract(spent_s, used_s) / (now_s - began_s))]
