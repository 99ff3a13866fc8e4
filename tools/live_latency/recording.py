"""Recording of monitors and playback of sound, by the sound server's command-line programs.

`parec` forwards frames of a monitor at once, so the earliest arrivals follow the monitor's clock.
Callbacks with blocks of fixed length would be less accurate, since frames would wait for a complete
block. The latency of 20 ms that is requested for recordings exceeds the latency of the daemon's
streams. The server therefore does not shorten the daemon's blocks.
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
PLAY_MS = 200  # latencies that are requested of the server, for recording and playback, in ms
PLAYER = "Stimulus"  # name of the playback stream
START_S = 5.0
_SAMPLE_BYTES = 4
_READ_BYTES = 1 << 16
_SPECIFICATION = re.compile(r"(\d+)ch (\d+)Hz")


class Recording:
    """A recording of one monitor, mixed to one channel, until `close`.

    source: name of the monitor.
    samplerate: in Hz.
    environment: environment variables that select the server.
    take: function that `drain` calls with new frames, (frames,) float32.

    NotFoundError: parec is not installed.
    LostError: nothing is recorded within 5 s.
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
        """Whether the recording program still runs."""
        return self._process.poll() is None

    def drain(self) -> None:
        """Call `take` with all frames that have arrived since the last `drain`."""
        ready = len(self._blocks)
        data = self._rest + b"".join(self._blocks[:ready])
        del self._blocks[:ready]
        whole = len(data) - len(data) % _SAMPLE_BYTES
        self._rest = data[whole:]
        if whole:
            self._take(np.frombuffer(data[:whole], np.float32))

    def line(self) -> ArrivalLine:
        """Return the earliest possible arrival times of all frames up to now."""
        count = len(self._bytes)
        frames = np.array(self._bytes[:count], dtype=np.intp) // _SAMPLE_BYTES
        return ArrivalLine(np.array(self._times_s[:count]), frames, self.samplerate)

    def close(self) -> None:
        """End the recording. Further calls have no effect."""
        end(self._process)
        self._reader.join(START_S)
        if self._process.stdout is not None and not self._reader.is_alive():
            self._process.stdout.close()


@contextmanager
def playing(
    sink: str, loop: Frames, samplerate: int, environment: Mapping[str, str]
) -> Iterator[None]:
    """Play a sound, (frames, channels), to a sink in a loop within a `with` block.

    NotFoundError: pacat is not installed.
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
    assert process.stdin is not None
    with suppress(OSError, ValueError):
        while True:
            os.write(process.stdin.fileno(), data)


def samplerate_of(source: str, environment: Mapping[str, str]) -> int:
    """Return the sample rate of a source in Hz; a recording at this rate is not resampled.

    NotFoundError: there is no such source, or pactl is not installed.
    LostError: the server does not answer.
    """
    for line in pactl(["list", "short", "sources"], environment).splitlines():
        cells = line.split("\t")
        if len(cells) > 3 and cells[1] == source and (found := _SPECIFICATION.search(cells[3])):
            return int(found[2])
    raise NotFoundError(f"there is no source {source!r}; see `pactl list short sources`")


def server_name(environment: Mapping[str, str]) -> str:
    """Return the server's name and version, such as "PulseAudio 16.1" or "PipeWire 0.3.65"."""
    lines = pactl(["info"], environment).splitlines()
    facts = dict(line.split(": ", 1) for line in lines if ": " in line)
    name = facts.get("Server Name", "")
    if found := re.search(r"\(on (PipeWire [^)]+)\)", name):
        return found[1]
    return f"{name.replace('pulseaudio', 'PulseAudio')} {facts.get('Server Version', '')}".strip()


def pactl(arguments: Sequence[str], environment: Mapping[str, str]) -> str:
    """Run pactl and return its output.

    NotFoundError: pactl is not installed.
    LostError: the server does not answer.
    """
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
    """Start a program. If setpriv is installed, the program ends when this process ends.

    NotFoundError: the program is not installed.
    """
    if shutil.which(command[0]) is None:
        raise NotFoundError(_not_installed(command[0]))
    bound = ("setpriv", "--pdeathsig", "TERM") if shutil.which("setpriv") else ()
    return subprocess.Popen(
        [*bound, *command], env=dict(environment), stdin=stdin, stdout=stdout, stderr=stderr
    )


def end(process: subprocess.Popen[bytes]) -> None:
    """End a program with SIGTERM, or with SIGKILL if it does not end within 5 s."""
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
