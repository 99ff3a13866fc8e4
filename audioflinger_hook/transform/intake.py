"""What arrives, made safe: unusable samples become 0 and are counted, channels become mono."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, Frames
from device.errors import UsageError

SAMPLES = (np.dtype(np.float32), np.dtype(np.float64))
"""The types of a sample, in the machine's own byte order."""

MAGNITUDE_MAX = 1e3
"""Samples above this (60 dB over full scale) are taken for damage, as NaN and Inf are."""

DENORMAL_GUARD = 1e-25
"""Added to every sample: too small for any result, large enough that no filter state, however
long the silence, decays into denormal numbers, whose arithmetic is many times slower."""


def fitting(frames: Frames, channels: int) -> Frames:
    """Return a block as (frames, channels) of one of `SAMPLES`.

    frames: (frames, channels) or, of one channel, (frames,); any type with a decimal point.

    Raises
    ------
    UsageError
        It is of another type or shape.
    """
    if frames.dtype.kind != "f":
        raise UsageError(
            f"a block of {frames.dtype} is not sound in full scale; allowed: float32, float64; "
            "divide integers by their own full scale first"
        )
    if frames.ndim == 1:
        frames = frames[:, None]
    if frames.ndim != 2 or frames.shape[1] != channels:
        raise UsageError(
            f"a block of shape {frames.shape} does not fit this stream; "
            f"allowed: (frames, {channels})"
        )
    return frames if frames.dtype in SAMPLES else frames.astype(np.float64)


def replace_unusable(frames: Frames) -> tuple[Frames, int]:
    """Return the frames with every unusable sample at 0, and how many there were.

    Unusable: not finite, or above `MAGNITUDE_MAX` in magnitude. Sound without one is returned
    as it is, not copied. Any shape. Called on the audio thread.
    """
    flat = frames.reshape(-1)
    # One product proves most blocks usable: no sample exceeds the root of the sum of squares,
    # and one that is not finite makes the sum so. (vdot, unlike dot, does not warn of that.)
    if np.vdot(flat, flat) <= MAGNITUDE_MAX**2:
        return frames, 0
    usable = np.abs(frames) <= MAGNITUDE_MAX
    if usable.all():
        return frames, 0
    return np.where(usable, frames, frames.dtype.type(0)), int(usable.size - usable.sum())


def mono(frames: Frames) -> FloatArray:
    """Return the mean of the channels, (frames,) float64, from (frames, channels).

    Channels are added one by one: a sum whose order depended on the block's shape would make
    the result depend on how the stream was cut.
    """
    channels = frames.shape[1]
    if channels == 1:
        return frames[:, 0].astype(np.float64)
    exact = np.asarray(frames, dtype=np.float64)
    total: FloatArray = exact[:, 0] + exact[:, 1]
    for channel in range(2, channels):
        total += exact[:, channel]
    total /= channels
    return total
