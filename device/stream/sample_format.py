"""Sample formats of devices (little endian), and the encoder from float frames to integers."""

from enum import Enum

import numpy as np

from device.blocks import whole_steps
from device.units import Float32Array


class SampleFormat(Enum):
    """A sample format; the value is its name in ALSA."""

    FLOAT32 = "FLOAT_LE"
    S16 = "S16_LE"
    S24_3 = "S24_3LE"  # 24 bits in three bytes
    S32 = "S32_LE"

    @property
    def bytes_per_sample(self) -> int:
        """Number of bytes per sample."""
        return {SampleFormat.S16: 2, SampleFormat.S24_3: 3}.get(self, 4)

    @property
    def bits(self) -> int:
        """Bits of resolution: 16, 24 or 32; 25 for a float (24-bit significand and sign)."""
        return 25 if self is SampleFormat.FLOAT32 else 8 * self.bytes_per_sample


class Encoder:
    """Encodes blocks of float frames as integers. Only one thread at a time may use it.

    A sample x becomes round(clip(x 2^n, -2^n, 2^n - 1)) with n = 15, 23 or 31. Halves are rounded
    away from zero. No dither is added. NaN becomes 0.
    sample_format: not FLOAT32. block_frames: usual block length; another length allocates memory.
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
        """Return `frames` as bytes; `frames` has shape (frames, channels) and full scale ±1."""
        if len(frames) != len(self._steps):
            self._allocate(len(frames))
        whole_steps(frames, self._full_scale, self._steps, self._rest, self._unknown)
        np.copyto(self._integers, self._steps, casting="unsafe")
        if self._is_packed:
            return self._integers.view(np.uint8).reshape(-1, 4)[:, :3].tobytes()
        return self._integers.tobytes()

    def decode_last(self) -> Float32Array:
        """Return the last encoded block as read-only floats; the highest 32-bit value becomes 1."""
        frames = np.empty(self._steps.shape, np.float32)
        # exact in float64, as the factor is a power of two; only the conversion to float32 rounds
        np.multiply(self._steps, 1.0 / self._full_scale, out=frames, casting="unsafe")
        frames.setflags(write=False)
        return frames
