"""Sample formats of devices (little endian), and the encoder from float frames to them."""

from __future__ import annotations

import math
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.blocks import emptied, peak
from device.rounding import whole_steps
from device.units import Float32Array


class SampleFormat(Enum):
    """A sample format; the value is ALSA's name for it."""

    FLOAT32 = "FLOAT_LE"
    S16 = "S16_LE"
    S24_3 = "S24_3LE"
    """24 bits in three bytes."""
    S32 = "S32_LE"

    @property
    def bytes_per_sample(self) -> int:
        """Bytes of one sample: 4, 2, 3, 4."""
        return _BYTES[self]

    @property
    def bits(self) -> int:
        """Bits of resolution: 16, 24, 32; a float has 25, which are 24 and a sign."""
        return 25 if self is SampleFormat.FLOAT32 else 8 * self.bytes_per_sample

    @property
    def full_scale(self) -> float:
        """The integer that stands for 1.0: 2^15, 2^23, 2^31; 1 for float."""
        return 1.0 if self is SampleFormat.FLOAT32 else 2.0 ** (self.bits - 1)


_BYTES = {
    SampleFormat.FLOAT32: 4,
    SampleFormat.S16: 2,
    SampleFormat.S24_3: 3,
    SampleFormat.S32: 4,
}


class Encoder:
    """Encodes float frames as a device takes them, block by block. One thread at a time uses it.

    Integers are round(clip(x 2^n, -2^n, 2^n - 1)) with n = 15, 23, 31, half away from zero, without
    dither. NaN becomes 0. Floats pass unchanged.

    sample_format: of the bytes. channels: per frame. block_frames: of a usual block. A usual block
    allocates its result only; another length allocates the scratch arrays again.
    """

    def __init__(self, sample_format: SampleFormat, channels: int, block_frames: int) -> None:
        self.sample_format = sample_format
        self.channels = channels
        self._is_float = sample_format is SampleFormat.FLOAT32
        self._allocate(block_frames)
        self._stored = b""

    def _allocate(self, frames: int) -> None:
        shape = (frames, self.channels)
        self._bytes_per_frame = self.channels * self.sample_format.bytes_per_sample
        self._silence = bytes(frames * self._bytes_per_frame)
        if self._is_float:
            return
        self._steps, self._rest = np.zeros(shape), np.zeros(shape)
        self._unknown = np.zeros(shape, np.bool_)
        self._words = np.zeros(shape, "<i4")
        self._items = _items(self.sample_format, shape)

    def encode(self, frames: Float32Array) -> bytes:
        """Return the bytes of `frames`, (frames, channels) float32, full scale ±1."""
        if self._is_float:
            self._stored = frames.tobytes()
            return self._stored
        if len(frames) != len(self._steps):
            self._allocate(len(frames))
        whole_steps(frames, self.sample_format.full_scale, self._steps, self._rest, self._unknown)
        if self.sample_format is SampleFormat.S24_3:
            np.copyto(self._words, self._steps, casting="unsafe")
            triples = self._words.view(np.uint8).reshape(*self._words.shape, 4)[..., :3]
            np.copyto(self._items, triples)
        else:
            np.copyto(self._items, self._steps, casting="unsafe")
        return self._items.tobytes()

    def encode_and_clear(self, frames: Float32Array) -> bytes | None:
        """Return the bytes of contiguous `frames`, and set these to 0.

        If a sample is not finite, return None and change nothing.
        """
        if self._is_float:
            stored = emptied(frames)
            if stored is not None:
                self._stored = stored
            return stored
        if not math.isfinite(peak(frames)):
            return None
        stored = self.encode(frames)
        frames.fill(0.0)
        return stored

    def silence(self, frames: int) -> bytes:
        """Return the bytes of this many silent frames."""
        length = frames * self._bytes_per_frame
        return self._silence if len(self._silence) == length else bytes(length)

    def decode_last(self) -> Float32Array:
        """Return the last encoded block as float32 frames, read only; the caller may keep them.

        They encode to the same bytes again. The highest step of 32 bits becomes 1.0.
        """
        if self._is_float:
            return np.frombuffer(self._stored, np.float32).reshape(-1, self.channels)
        frames = np.empty(self._steps.shape, np.float32)
        # exact in float64, as the factor is a power of two; only the store can round
        np.multiply(self._steps, 1.0 / self.sample_format.full_scale, out=frames, casting="unsafe")
        frames.setflags(write=False)
        return frames


def _items(sample_format: SampleFormat, shape: tuple[int, int]) -> NDArray[Any]:
    """Return an array with the memory layout of the encoded bytes."""
    if sample_format is SampleFormat.S24_3:
        return np.zeros((*shape, 3), np.uint8)
    return np.zeros(shape, {SampleFormat.S16: "<i2", SampleFormat.S32: "<i4"}[sample_format])
