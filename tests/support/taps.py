"""Frames for taps, and everything that a tap or a client delivers."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from audioflinger_hook.mixer import Mixer
from audioflinger_hook.sources import Client, Tap
from device.units import Float32Array


def noise(frames: int, channels: int = 2, seed: int = 0) -> Float32Array:
    """Return white noise up to 0.9, (frames, channels)."""
    random = np.random.default_rng(seed)
    return random.uniform(-0.9, 0.9, (frames, channels)).astype(np.float32)


def buffers_of(tap: Tap) -> Iterator[Float32Array]:
    """Yield every buffer of a tap, which is closed at the end."""
    while (buffer := tap.read()) is not None:
        yield buffer
    tap.close()


def frames_of(tap: Tap) -> Float32Array:
    """Return all frames of a tap, which is closed."""
    return np.concatenate(list(buffers_of(tap)))


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
