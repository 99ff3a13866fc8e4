"""Sample formats of tracks and sinks: conversion of bytes to float frames and back."""

from enum import Enum
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from device.blocks import whole_steps
from device.errors import UsageError
from device.units import Float32Array

FLOAT_LIMIT = 2.0  # largest sample of float sinks, 6 dB above full scale, as in AudioFlinger


class PcmFormat(Enum):
    """Little-endian format of stored samples. full_scale: stored value of 1.0 minus that of 0.0."""

    U8 = "u8", 1, "u1", 2.0**7
    I16 = "i16", 2, "<i2", 2.0**15
    I24 = "i24", 3, "u1", 2.0**23
    I32 = "i32", 4, "<i4", 2.0**31
    FLOAT = "float", 4, "<f4", 1.0

    # Attributes are faster than properties, and the mixer reads these for every block.
    bytes_per_sample: int
    dtype: np.dtype[Any]  # type of a stored sample; for I24, type of a byte of a sample
    full_scale: float

    def __new__(cls, name: str, bytes_per_sample: int, dtype: str, full_scale: float) -> Self:
        """Create a member of the enumeration."""
        member = object.__new__(cls)
        member._value_ = name
        member.bytes_per_sample, member.full_scale = bytes_per_sample, full_scale
        member.dtype = np.dtype(dtype)
        return member


PcmData = bytes | bytearray | memoryview | NDArray[Any]


def stored_frames(stored: PcmData, pcm_format: PcmFormat, channels: int) -> NDArray[Any]:
    """Return samples with one row per frame: (frames, channels), for I24 (frames, channels x 3).

    The rows are a view of `stored` if its memory layout allows a view, otherwise a copy.
    stored: bytes, or an array of the format's `dtype`, with one dimension or one row per frame.
    UsageError: the samples have a wrong type or shape, or the last frame is incomplete.
    """
    bytes_per_frame = channels * pcm_format.bytes_per_sample
    items = bytes_per_frame // pcm_format.dtype.itemsize
    if isinstance(stored, np.ndarray):
        if stored.dtype != pcm_format.dtype:
            raise UsageError(
                f"samples of type {stored.dtype} given for a track of format {pcm_format.value}; "
                f"convert them to {pcm_format.dtype}"
            )
        whole = stored.ndim == 1 and stored.size % items == 0
        if not whole and not (stored.ndim == 2 and stored.shape[1] == items):
            raise UsageError(
                f"samples of shape {stored.shape} given for {channels} channels of format "
                f"{pcm_format.value}; want (frames, {items}), or (a multiple of {items},)"
            )
        return stored.reshape(-1, items)
    try:
        view = memoryview(stored)
    except TypeError:
        raise UsageError(
            f"samples of type {type(stored).__name__} given; want bytes or a NumPy array"
        ) from None
    if view.nbytes % bytes_per_frame:
        raise UsageError(
            f"{view.nbytes} bytes given for {channels} channels of format {pcm_format.value}; "
            f"want a multiple of {bytes_per_frame}"
        )
    whole_bytes = view.cast("B") if view.c_contiguous else view.tobytes()
    return np.frombuffer(whole_bytes, pcm_format.dtype).reshape(-1, items)


def decode_rows(rows: NDArray[Any], pcm_format: PcmFormat, frames: Float32Array) -> None:
    """Decode n rows of `stored_frames` to `frames`, (n, channels). Only I32 samples are rounded."""
    if pcm_format is PcmFormat.FLOAT:
        frames[...] = rows
    elif pcm_format is PcmFormat.U8:
        np.subtract(rows, np.float32(128.0), out=frames)
        frames *= np.float32(1.0 / pcm_format.full_scale)
    elif pcm_format is PcmFormat.I24:
        triples = rows.reshape(len(rows), frames.shape[1], 3)
        words = np.zeros((*frames.shape, 4), np.uint8)
        # In the upper three bytes, the sign bit of I24 becomes the sign bit of int32.
        words[..., 1:] = triples
        np.multiply(words.view("<i4")[..., 0], np.float32(2.0**-31), out=frames, casting="unsafe")
    else:
        # The product is exact in float64, so only the conversion to float32 rounds.
        np.multiply(rows, 1.0 / pcm_format.full_scale, out=frames, casting="unsafe")


def decode(stored: PcmData, pcm_format: PcmFormat, channels: int) -> Float32Array:
    """Decode samples to (frames, channels), full scale ±1. UsageError: as for `stored_frames`."""
    rows = stored_frames(stored, pcm_format, channels)
    frames = np.empty((len(rows), channels), np.float32)
    decode_rows(rows, pcm_format, frames)
    return frames


def encode(frames: NDArray[np.floating[Any]], pcm_format: PcmFormat) -> bytes:
    """Encode frames as bytes: clip, then round without dither. NaN becomes 0.

    Integers are round(clip(x 2^n, -2^n, 2^n - 1)) with n = 7, 15, 23 or 31; halves are rounded away
    from zero. For U8, 128 is added. Float samples are clipped to ±2.0.
    """
    if pcm_format is PcmFormat.FLOAT:
        clamped = np.clip(frames, -FLOAT_LIMIT, FLOAT_LIMIT).astype("<f4")
        return np.where(np.isnan(clamped), np.float32(0.0), clamped).tobytes()
    whole, rest = np.empty(frames.shape), np.empty(frames.shape)
    whole_steps(frames, pcm_format.full_scale, whole, rest, np.empty(frames.shape, np.bool_))
    if pcm_format is PcmFormat.U8:
        return (whole + 128.0).astype(np.uint8).tobytes()
    if pcm_format is PcmFormat.I24:
        return whole.astype("<i4").reshape(-1, 1).view(np.uint8)[:, :3].tobytes()
    return whole.astype(pcm_format.dtype).tobytes()
