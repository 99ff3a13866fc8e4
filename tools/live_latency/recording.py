"""Monitors recorded side by side, and a sound played meanwhile, by the server's own small programs.

`parec` hands over what a monitor has rendered at once, so the earliest arrivals tell its clock
to some hundredths of a millisecond. Callbacks of 256 frames would not: PulseAudio renders some 255
at a time, the rest waits for the next callback, and the line of arrivals wanders by 5 ms for
seconds. Requests of 20 ms are longer than the daemon's: its blocks are not made shorter by them.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import threading
import time
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress

import numpy as np

from audioflinger_hook.transform import Frames
from device.errors import LostError, NotFoundError
from tools.live_latency.arrival import ArrivalLine

RECORD_MS = 20
PLAY_MS = 200
"""Requested of the server: what is recorded comes in blocks of at most so long, ..."""

PLAYER = "Stimulus"
"""Name of what plays."""

START_S = 5.0
_SAMPLE_BYTES = 4
_READ_BYTES = 1 << 16
_SPECIFICATION = re.compile(r"(\d+)ch (\d+)Hz")


class Recording:
    """One monitor, mixed to one channel, from now on until `close`.

    take(frames): called by `drain` with the (frames,) float32 that came. A thread of its own reads
    and notes times of time.monotonic(); one thread calls the methods.

    Raises
    ------
    NotFoundError
        parec is not installed.
    LostError
        Nothing was recorded within START_S.
    """

    def __init__(
        self,
        source: str,
        samplerate: int,
        environment: Mapping[str, str],
        take: Callable[[Frames], object],
    ) -> None:
        self.source = source
        self.samplerate = samplerate
        self._take = take
        self._blocks: list[bytes] = []
        self._rest = b""
        self._times_s = array("d")
        self._bytes = array("q")
        self._process = spawn(
            ["parec", *_format(source, samplerate, 1, RECORD_MS)],
            environment,
            stdout=subprocess.PIPE,
        )
        self._reader = threading.Thread(target=self._read, name=f"record {source}", daemon=True)
        self._reader.start()
        limit_s = time.monotonic() + START_S
        while not self._bytes:
            if time.monotonic() > limit_s or self._process.poll() is not None:
                self.close()
                raise LostError(
                    f"nothing is recorded from {source!r}; see whether the sound server runs and "
                    "has that monitor: pactl list short sources"
                )
            time.sleep(0.005)

    def _read(self) -> None:
        assert self._process.stdout is not None
        pipe = self._process.stdout.fileno()
        count = 0
        while data := os.read(pipe, _READ_BYTES):
            now_s = time.monotonic()
            count += len(data)
            self._blocks.append(data)
            self._times_s.append(now_s)
            self._bytes.append(count)

    @property
    def running(self) -> bool:
        """Whether it still records."""
        return self._process.poll() is None

    def drain(self) -> None:
        """Hand over what has come since the last time."""
        ready = len(self._blocks)
        data = self._rest + b"".join(self._blocks[:ready])
        del self._blocks[:ready]
        whole = len(data) - len(data) % _SAMPLE_BYTES
        self._rest = data[whole:]
        if whole:
            self._take(np.frombuffer(data[:whole], np.float32))

    def line(self) -> ArrivalLine:
        """Return when its frames could first be had, as of now."""
        count = len(self._bytes)
        frames = np.array(self._bytes[:count], dtype=np.intp) // _SAMPLE_BYTES
        return ArrivalLine(np.array(self._times_s[:count]), frames, self.samplerate)

    def close(self) -> None:
        """End it; again, too."""
        end(self._process)
        self._reader.join(START_S)
        if self._process.stdout is not None and not self._reader.is_alive():
            self._process.stdout.close()


@contextmanager
def playing(
    sink: str, loop: Frames, samplerate: int, environment: Mapping[str, str]
) -> Iterator[None]:
    """A context in which (frames, channels) are played to a sink over and over.

    Raises
    ------
    NotFoundError
        pacat is not installed.
    """
    command = ["pacat", "--playback", f"--client-name={PLAYER}", "--property=media.role=music"]
    process = spawn(
        [*command, *_format(sink, samplerate, loop.shape[1], PLAY_MS)],
        environment,
        stdin=subprocess.PIPE,
    )
    feeder = threading.Thread(
        target=_feed, args=(process, loop.astype(np.float32).tobytes()), daemon=True
    )
    feeder.start()
    try:
        yield
    finally:
        end(process)
        feeder.join(START_S)
        with suppress(BrokenPipeError):
            assert process.stdin is not None
            process.stdin.close()


def _feed(process: subprocess.Popen[bytes], data: bytes) -> None:
    """Write until the player has ended; its pipe is full nearly always, and the write waits."""
    assert process.stdin is not None
    with suppress(OSError, ValueError):
        while True:
            os.write(process.stdin.fileno(), data)


def samplerate_of(source: str, environment: Mapping[str, str]) -> int:
    """Return the samplerate of a source in Hz, so that nothing is resampled for the recording.

    Raises
    ------
    NotFoundError
        There is no such source, or no pactl.
    LostError
        The server does not answer.
    """
    for line in pactl(["list", "short", "sources"], environment).splitlines():
        cells = line.split("\t")
        if len(cells) > 3 and cells[1] == source and (found := _SPECIFICATION.search(cells[3])):
            return int(found[2])
    raise NotFoundError(f"there is no source {source!r}; see `pactl list short sources`")


def server_name(environment: Mapping[str, str]) -> str:
    """Return the server's name and version, as in "PulseAudio 16.1" or "PipeWire 0.3.65"."""
    lines = pactl(["info"], environment).splitlines()
    facts = dict(line.split(": ", 1) for line in lines if ": " in line)
    name = facts.get("Server Name", "")
    if found := re.search(r"\(on (PipeWire [^)]+)\)", name):
        return found[1]
    return f"{name.replace('pulseaudio', 'PulseAudio')} {facts.get('Server Version', '')}".strip()


def pactl(arguments: Sequence[str], environment: Mapping[str, str]) -> str:
    """Return what pactl prints; raises as `samplerate_of`."""
    try:
        done = subprocess.run(
            ["pactl", *arguments],
            env={**environment, "LC_ALL": "C"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=START_S,
        )
    except FileNotFoundError:
        raise NotFoundError(_not_installed("pactl")) from None
    except subprocess.TimeoutExpired:
        raise LostError("the sound server does not answer pactl; restart it") from None
    if done.returncode:
        raise LostError(f"the sound server does not answer pactl: {done.stderr.strip()}")
    return done.stdout


def spawn(
    command: list[str],
    environment: Mapping[str, str],
    *,
    stdin: int = subprocess.DEVNULL,
    stdout: int = subprocess.DEVNULL,
    stderr: int = subprocess.DEVNULL,
) -> subprocess.Popen[bytes]:
    """Return the program, started; it ends with this process, even if that is killed.

    Raises
    ------
    NotFoundError
        It is not installed.
    """
    if shutil.which(command[0]) is None:
        raise NotFoundError(_not_installed(command[0]))
    bound = ("setpriv", "--pdeathsig", "TERM") if shutil.which("setpriv") else ()
    return subprocess.Popen(
        [*bound, *command], env=dict(environment), stdin=stdin, stdout=stdout, stderr=stderr
    )


def end(process: subprocess.Popen[bytes]) -> None:
    """End a program, kindly first."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(START_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _not_installed(program: str) -> str:
    return f"{program} is not installed; run tools/fetch_servers.sh"


def _format(device: str, samplerate: int, channels: int, latency_ms: int) -> list[str]:
    return [
        f"--device={device}",
        "--raw",
        "--format=float32le",
        f"--rate={samplerate}",
        f"--channels={channels}",
        f"--latency-msec={latency_ms}",
    ]
