"""Frames for taps, and everything that a tap or a client delivers."""

import math

import numpy as np

from audioflinger_hook.mixer import Mixer
from audioflinger_hook.sources import Client, Tap
from device.units import Float32Array


def noise(frames: int, channels: int = 2, seed: int = 0) -> Float32Array:
    """Return white noise up to 0.9, (frames, channels)."""
    return np.random.default_rng(seed).uniform(-0.9, 0.9, (frames, channels)).astype(np.float32)


def frames_of(tap: Tap) -> Float32Array:
    buffers = []
    while (buffer := tap.read()) is not None:
        buffers.append(buffer)
    tap.close()
    return np.concatenate(buffers)


class BufferTap:
    """Delivers the given buffers: (frames, samplerate, whether frames are missing before it)."""

    def __init__(self, *buffers):
        self._buffers = list(buffers)
        self.samplerate, self.channels = buffers[0][1], buffers[0][0].shape[1]
        self.format_changed = self.discontinuity = False
        self.closed = 0

    @property
    def frames_expected(self):
        return sum(len(frames) for frames, *_ in self._buffers)

    def read(self):
        if not self._buffers:
            return None
        frames, samplerate, self.discontinuity = self._buffers.pop(0)
        before = (self.samplerate, self.channels)
        self.samplerate, self.channels = samplerate, frames.shape[1]
        self.format_changed = (self.samplerate, self.channels) != before
        return frames

    def close(self):
        self._buffers = []
        self.closed += 1


def cut(frames, lengths, samplerate=48_000):
    """A tap of frames in buffers of the given lengths, and one of the rest."""
    ends = np.minimum(np.cumsum(lengths, dtype=int), len(frames))
    return BufferTap(*((part, samplerate, False) for part in np.split(frames, ends)))


def mixer_for(client: Client, samplerate: int = 0, channels: int = 0) -> Mixer:
    """Return a mixer that the client is connected to; by default the one that suits it."""
    rate, wide = samplerate or client.samplerate, channels or client.channels
    mixer = Mixer(rate, wide, standby_delay_s=math.inf)
    client.connect(mixer)
    return mixer


def mixed(client: Client, mixer: Mixer) -> list[Float32Array]:
    """Return the sound of every cycle until the client ends or has nothing to play."""
    blocks = []
    while frames := client.play():
        report = mixer.cycle(0.0, frames)
        assert (report.frames_written, report.underruns) == (frames, 0)
        blocks.append(report.buffer.audio.copy())
    return blocks
