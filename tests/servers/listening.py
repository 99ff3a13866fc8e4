"""What the tests of sound servers share: waiting, playing, recording, and signals worth finding."""

import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
import pytest

from device.errors import LostError
from device.server.pulse import PulseConnection
from device.server.snapshot import Event, Listener, ServerSnapshot
from device.stream.pcms import PcmConfig, ServerDevice
from device.stream.streams import CaptureStream, PlaybackStream
from device.units import Float32Array
from tools.sound_server import SoundServer

RATE_HZ = 48_000
LEVEL = np.float32(0.25)
ATTEMPTS = 3  # a shared machine drops whole buffers now and then, or leaves a stream silent

Found = TypeVar("Found")


def need(missing: Sequence[str]) -> None:
    """Skip a test for which programs are missing; with CI=true, fail it."""
    if missing and os.environ.get("CI") == "true":
        pytest.fail(f"missing: {', '.join(missing)}")
    if missing:
        pytest.skip(f"missing: {', '.join(missing)}; run tools/fetch_servers.sh")


def count_stuck() -> int:
    """How many streams PortAudio never started: each holds the thread that started it."""
    return sum(thread.name.startswith("start ") for thread in threading.enumerate())


def wait_for(condition: Callable[[], Found | None], what: str, limit_s: float = 10.0) -> Found:
    """What the condition gives once that is true; looks every millisecond."""
    deadline_s = time.monotonic() + limit_s
    while not (found := condition()):
        assert time.monotonic() < deadline_s, f"no {what} within {limit_s} s"
        time.sleep(0.001)
    return found


def wait_seconds(seconds: float) -> None:
    until_s = time.monotonic() + seconds
    wait_for(lambda: time.monotonic() > until_s, "time", seconds + 10.0)


def more(heard: Callable[[], Float32Array], seconds: float) -> Float32Array:
    begin = len(heard())
    end = begin + int(seconds * RATE_HZ)
    wait_for(lambda: len(heard()) >= end, f"{seconds:g} s more", 10.0 + 2.0 * seconds)
    return heard()[begin:end]


def level_db(frames: Float32Array) -> float:
    return float(10.0 * np.log10(np.mean(np.square(frames, dtype=np.float64)) + 1e-20))


def insist_on_default(server: SoundServer, connection: PulseConnection, sink: str) -> None:
    """Make a sink the default one, and see that the connection is told and that it stays.

    PipeWire may leave one connection with the default sink of before, and tells nothing new after
    an equal wish. So another sink is wished for in between.
    """

    def stays() -> bool:
        server.choose_default(sink)
        asked_s, seen_s = time.monotonic(), None
        while time.monotonic() - asked_s < 2.0:
            if connection.snapshot().default_sink != sink:
                seen_s = None
            elif time.monotonic() - (seen_s := seen_s or time.monotonic()) > 0.3:
                return True
        server.choose_default(next(name for name in server.names("sinks") if name != sink))
        return False

    wait_for(stays, f"default sink {sink} that stays", 30.0)


class Notes(Listener):
    """Everything that a connection told, with the time at which it did."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.snapshots: list[ServerSnapshot] = []
        self.defaults: list[tuple[float, str]] = []
        self.lost: list[tuple[float, LostError]] = []

    def on_event(self, event: Event) -> bool:
        self.events.append(event)
        return False

    def on_snapshot(self, snapshot: ServerSnapshot) -> None:
        self.snapshots.append(snapshot)

    def on_default_sink(self, name: str) -> None:
        self.defaults.append((time.monotonic(), name))

    def on_lost(self, error: LostError) -> None:
        self.lost.append((time.monotonic(), error))


class Collector:
    def __init__(self) -> None:
        self._buffers: list[Float32Array] = []

    def __call__(self, frames: Float32Array, now_s: float) -> None:
        self._buffers.append(frames)

    def frames(self) -> Float32Array:
        buffers = list(self._buffers)
        return np.concatenate(buffers) if buffers else np.zeros((0, 2), np.float32)


def open_tap(pcms, on_frames, source="desktop.monitor", **options) -> CaptureStream:
    pcms.pcms["cushion_tap"].target = ServerDevice(source)
    return CaptureStream(pcms.pcms["cushion_tap"], RATE_HZ, 2, on_frames, **options)


def open_output(pcms: PcmConfig, sink: str = "haptic") -> PlaybackStream:
    """A stream that plays `steady` to a sink once it is audible."""
    pcms.pcms["cushion_output"].target = ServerDevice(sink)
    return PlaybackStream(pcms.pcms["cushion_output"], RATE_HZ, 2, steady)


def steady(out: Float32Array, now_s: float) -> None:
    out[:] = LEVEL


def noise(seconds: float, seed: int = 1) -> Float32Array:
    """Stereo float32 noise without a zero: every sample tells where it belongs."""
    samples = np.random.default_rng(seed).uniform(0.05, 0.5, (int(seconds * RATE_HZ), 2))
    return samples.astype(np.float32)


def sounding(frames: Float32Array) -> Float32Array:
    """The frames without those that are silent: `noise` has none, a busy machine inserts some."""
    return frames[frames.any(axis=1)]


@contextmanager
def own_server(kind: str = "pipewire", **options: Any) -> Iterator[SoundServer]:
    """A server in a folder of its own; tmp_path is too long for the path of a socket."""
    with (
        tempfile.TemporaryDirectory(prefix="cushion-") as folder,
        SoundServer(kind, Path(folder), **options) as server,
    ):
        yield server


def onsets(frames: Float32Array, level: float) -> list[int]:
    """The frames at which a recording exceeds a level after a tenth of a second below."""
    loud = np.flatnonzero(np.abs(frames).max(axis=1, initial=0.0) > level)
    return [int(frame) for frame in loud[np.diff(loud, prepend=-RATE_HZ) > RATE_HZ // 10]]


@contextmanager
def playing(
    server: SoundServer,
    sink: str,
    samples: Float32Array,
    *,
    name: str = "Player",
    role: str = "music",
    rate_hz: int = RATE_HZ,
    latency_ms: int = 200,
    properties: Mapping[str, str] = MappingProxyType({}),
) -> Iterator[int]:
    """Another program that plays these samples to a sink; its process id. role: "" for none."""
    told = {**({"media.role": role} if role else {}), **properties}
    command = [
        *("pacat", "--playback", f"--client-name={name}"),
        *(f"--property={key}={value}" for key, value in told.items()),
        *_format(sink, latency_ms, rate_hz),
    ]
    with _process(server, command, stdin=subprocess.PIPE) as process:
        feeder = threading.Thread(target=_feed, args=(process, samples.tobytes()), daemon=True)
        feeder.start()
        yield process.pid
    feeder.join(5.0)


@contextmanager
def recording(
    server: SoundServer,
    source: str,
    path: Path,
    *,
    stays: bool = False,
    rate_hz: int = RATE_HZ,
    properties: Mapping[str, str] = MappingProxyType({}),
) -> Iterator[Callable[[], Float32Array]]:
    """Another program that records a source; a function that gives what it has so far.

    stays: PipeWire does not lead it elsewhere with the default sink. PulseAudio does that only
    with a recording of the default source.
    """
    with path.open("wb") as file:

        def heard() -> Float32Array:
            whole = path.read_bytes()
            return np.frombuffer(whole[: len(whole) // 8 * 8], np.float32).reshape(-1, 2)

        options = [
            *_format(source, 20, rate_hz),
            *(["--property=node.dont-reconnect=true"] if stays else []),
            *(f"--property={key}={value}" for key, value in properties.items()),
        ]
        for left in reversed(range(ATTEMPTS)):  # PipeWire may leave a new recorder without data
            with _process(server, ["parec", *options], stdout=file.fileno()):
                try:
                    wait_for(lambda: len(heard()) > 0, f"sound from {source}")
                except AssertionError:
                    if not left:
                        raise
                    continue
                yield heard
                return


class Arrivals:
    """Another program that records a source, with the time at which each frame came."""

    def __init__(self, process: Any) -> None:
        self._process = process
        self._parts: list[tuple[int, float]] = []
        self._bytes = bytearray()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while part := os.read(self._process.stdout.fileno(), 1 << 16):
            self._bytes += part
            self._parts.append((len(self._bytes) // 8, time.monotonic()))

    def frames(self) -> Float32Array:
        whole = bytes(self._bytes)
        return np.frombuffer(whole[: len(whole) // 8 * 8], np.float32).reshape(-1, 2)

    def at_s(self, frame: int) -> float:
        """When a frame was recorded, but for what every such recording needs at least.

        Only what came in the half second around it counts: a busy machine loses frames.
        """
        near = [
            at_s - (frames - frame) / RATE_HZ
            for frames, at_s in tuple(self._parts)
            if abs(frames - frame) < RATE_HZ // 4
        ]
        return min(near)

    def end(self) -> None:
        self._thread.join(5.0)
        self._process.stdout.close()


@contextmanager
def arriving(server: SoundServer, source: str) -> Iterator[Arrivals]:
    """A recording by another program whose frames have times; it stays on its source."""
    command = ["parec", *_format(source, 5), "--property=node.dont-reconnect=true"]
    with _process(server, command, stdout=subprocess.PIPE) as process:
        arrivals = Arrivals(process)
        try:
            wait_for(lambda: len(arrivals.frames()) > 0, f"sound from {source}")
            yield arrivals
        finally:
            process.kill()
            arrivals.end()


def _format(device: str, latency_ms: int, rate_hz: int = RATE_HZ) -> list[str]:
    return [
        f"--device={device}",
        "--raw",
        "--format=float32le",
        f"--rate={rate_hz}",
        "--channels=2",
        f"--latency-msec={latency_ms}",
    ]


@contextmanager
def _process(server, command, **pipes: Any) -> Iterator[subprocess.Popen[bytes]]:
    silent: Any = {"stdin": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, env=server.environment, **(silent | pipes))
    try:
        yield process
    finally:
        process.kill()
        process.wait(5.0)
        if process.stdin is not None:
            with suppress(BrokenPipeError):
                process.stdin.close()


def _feed(process: Any, data: bytes) -> None:
    with suppress(BrokenPipeError, ValueError):  # the test may be over by now
        process.stdin.write(data)
        process.stdin.flush()
