"""The clicks of `cushion sync`, played on one output."""

import time
from collections.abc import Iterator
from contextlib import closing, contextmanager

import numpy as np

from device.errors import LostError
from device.server.snapshot import Sink
from device.stream import PlaybackStream
from device.stream.pcms import Pcm, ServerDevice
from device.units import Float32Array

# The profiles for live sound turn this short click into a strong tap of about 16 ms.
CLICK_HZ, DECAY_S, CLICK_S, LEVEL = 2_000.0, 0.004, 0.04, 0.25
BEGINS_S = 5.0  # longest time until a new stream plays


class Clicks:
    """Plays a click whenever `play` is called, while its stream is open."""

    def __init__(self, samplerate: int) -> None:
        time_s = np.arange(round(CLICK_S * samplerate)) / samplerate
        wave = np.cos(2.0 * np.pi * CLICK_HZ * time_s) * np.exp(-time_s / DECAY_S)
        self._click = (LEVEL * wave).astype(np.float32)
        self._next = self._click.size  # frame of the click to play next
        self.stream: PlaybackStream | None = None

    def play(self) -> None:
        """Begin a click. LostError: the stream has ended."""
        if self.stream is None or self.stream.is_lost():
            raise LostError("the output was lost during the test; connect it, and try again")
        self._next = 0

    def fill(self, out: Float32Array, now_s: float) -> None:
        """Write the next frames to the first two channels. Only the output's thread calls it."""
        part = self._click[self._next : self._next + len(out)]
        out[: part.size, :2] = part[:, None]
        self._next += part.size


@contextmanager
def open_clicks(sink: Sink, pcm: Pcm) -> Iterator[Clicks]:
    """Open a stream for clicks on a sink. LostError: it does not play within BEGINS_S."""
    pcm.target = ServerDevice(sink.name)
    clicks = Clicks(sink.samplerate)
    stream = clicks.stream = PlaybackStream(pcm, sink.samplerate, sink.channels, clicks.fill)
    with closing(stream):
        stream.audible = True
        end_s = time.monotonic() + BEGINS_S
        while stream.callbacks < 2:
            if time.monotonic() > end_s:
                raise LostError(f"{sink.name} does not play after {BEGINS_S:g} s; check the output")
            time.sleep(0.01)
        yield clicks
