"""Sample formats of devices (little endian), and the encoder from float frames to integers."""

from __future__ import annotations

from enum import Enum

import numpy as np

from device.blocks import whole_steps
from device.units import Float32Array


class SampleFormat(Enum):
    """A sample format; the value is ALSA's name for it."""

    FLOAT32 = "FLOAT_LE"
    S16 = "S16_LE"
    S24_3 = "S24_3LE"  # 24 bits in three bytes
    S32 = "S32_LE"

    @property
    def bytes_per_sample(self) -> int:
        """Bytes of one sample: 4, 2, 3, 4."""
        return {SampleFormat.S16: 2, SampleFormat.S24_3: 3}.get(self, 4)

    @property
    def bits(self) -> int:
        """Bits of resolution: 16, 24, 32; a float has 25, which are 24 and a sign."""
        return 25 if self is SampleFormat.FLOAT32 else 8 * self.bytes_per_sample


class Encoder:
    """Encodes float frames as integers for a device, block by block. Use from one thread at a time.

    Integers are round(clip(x 2^n, -2^n, 2^n - 1)) with n = 15, 23, 31, half away from zero, without
    dither. NaN becomes 0.

    sample_format: not FLOAT32. block_frames: usual length of a block; another length allocates the
    scratch arrays again.
    """

    def __init__(self, sample_format: SampleFormat, channels: int, block_frames: int) -> None:
        self._full_scale = 2.0 ** (sample_format.bits - 1)
        self._is_packed = sample_format is SampleFormat.S24_3
        self._dtype = "<i2" if sample_format is SampleFormat.S16 else "<i4"
        self._channels = channels
        self._allocate(block_frames)

    def _allocate(self, frames: int) -> None:
        shape = (frames, self._channels)
        self._steps, self._rest = np.zeros(shape), np.zeros(shape)
        self._unknown = np.zeros(shape, np.bool_)
        self._integers = np.zeros(shape, self._dtype)

    def encode(self, frames: Float32Array) -> bytes:
        """Return the bytes of `frames`, (frames, channels) float32, full scale ±1."""
        if len(frames) != len(self._steps):
            self._allocate(len(frames))
        whole_steps(frames, self._full_scale, self._steps, self._rest, self._unknown)
        np.copyto(self._integers, self._steps, casting="unsafe")
        if self._is_packed:
            return self._integers.view(np.uint8).reshape(-1, 4)[:, :3].tobytes()
        return self._integers.tobytes()

    def decode_last(self) -> Float32Array:
        """Return read-only float32 frames that encode to the last bytes; the caller may keep them.

        The highest step of 32 bits becomes 1.0.
        """
        frames = np.empty(self._steps.shape, np.float32)
        # exact in float64, as the factor is a power of two; only the store can round
        np.multiply(self._steps, 1.0 / self._full_scale, out=frames, casting="unsafe")
        frames.setflags(write=False)
        return frames
