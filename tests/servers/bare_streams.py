"""Streams that do nothing, beside the ones under test: what the server and the machine do to any.

A program of its own, `python -m tests.servers.bare_streams FRAMES TAP SINK [TAP'S SERVER, SINK'S
SERVER]`, until it is killed: its processor time is what streams alone cost, and when its callbacks
did not come in time, which it prints, nobody's did.
"""

import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

from audioflinger_hook.cli.process import freeze_loaded_objects
from device.stream import CaptureStream, PcmConfig, PlaybackStream, filter_stderr
from device.stream.pcms import ServerDevice
from device.units import Float32Array
from tests.servers.daemons import program
from tests.servers.listening import RATE_HZ
from tools.live_latency.pauses import Pause

WITNESS_FRAMES = 256
CAPTURE_LATE_S = 0.022
"""Of blocks of so many frames. Captured ones come in twos where the server's own are longer."""
PLAYBACK_LATE_S = 0.012
TELLS_S = 0.2


class Late:
    """Callbacks of one stream, within limit_s of each other unless something is wrong."""

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._before_s: float | None = None
        self.gaps: list[tuple[float, float]] = []

    def __call__(self, frames: Float32Array, now_s: float) -> None:
        before_s, self._before_s = self._before_s, now_s
        if before_s is not None and now_s - before_s > self._limit_s:
            self.gaps.append((before_s, now_s))


def main(block_frames, tap, sink, tap_server=None, sink_server=None):
    filter_stderr()
    config = PcmConfig("bare_tap", "bare_output")
    captured, played = Late(CAPTURE_LATE_S), Late(PLAYBACK_LATE_S)
    config.pcms["bare_output"].target = ServerDevice(sink, sink_server)
    playback = PlaybackStream(
        config.pcms["bare_output"], RATE_HZ, 2, played, block_frames=block_frames
    )
    playback.audible = True
    config.pcms["bare_tap"].target = ServerDevice(tap, tap_server)
    capture = CaptureStream(
        config.pcms["bare_tap"], RATE_HZ, 2, captured, block_frames=block_frames
    )
    freeze_loaded_objects()
    print("ready", flush=True)
    while not threading.Event().wait(TELLS_S):
        for late in (captured, played):
            while late.gaps:
                print(*late.gaps.pop(0), flush=True)
    del playback, capture


class BareStreams:
    def __init__(self, process: Any) -> None:
        self.process = process
        self._gaps: list[Pause] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._reader.join()

    def _read(self) -> None:
        for line in self.process.stdout:
            self._gaps.append(Pause(*map(float, line.split())))

    @property
    def gaps(self) -> tuple[Pause, ...]:
        """When callbacks did not come in time, so far."""
        return tuple(self._gaps)


@contextmanager
def bare_streams(environment, *arguments, block_frames=WITNESS_FRAMES) -> Iterator[BareStreams]:
    """They run from when both are open until the context ends. arguments: of `main`."""
    command = (sys.executable, "-m", "tests.servers.bare_streams", str(block_frames), *arguments)
    with program(environment, *command) as process:
        assert process.stdout.readline() == "ready\n"
        with closing(BareStreams(process)) as bare:
            yield bare


if __name__ == "__main__":
    main(int(sys.argv[1]), *sys.argv[2:])
