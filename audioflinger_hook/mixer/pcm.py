"""Sample formats of tracks and sinks: bytes to float frames and back, with one rounding rule."""

from __future__ import annotations

from enum import Enum
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from device.blocks import whole_steps
from device.errors import UsageError
from device.units import Float32Array

FLOAT_LIMIT = 2.0  # largest sample of float sinks, 6 dB over full scale, as in AudioFlinger


class PcmFormat(Enum):
    """How one sample is stored, little endian; the enum value is the format's name in a dump.

    bytes_per_sample: 1, 2, 3 (packed), 4, 4. dtype: type of an array of such samples; bytes for
    I24. full_scale: the stored number that means 1.0: 2^7, 2^15, 2^23, 2^31; 1 for float.
    """

    U8 = "u8", 1, "u1", 2.0**7
    I16 = "i16", 2, "<i2", 2.0**15
    I24 = "i24", 3, "u1", 2.0**23
    I32 = "i32", 4, "<i4", 2.0**31
    FLOAT = "float", 4, "<f4", 1.0

    # Attributes of each member, not properties: every block that is mixed asks for them.
    bytes_per_sample: int
    dtype: np.dtype[Any]
    full_scale: float

    def __new__(cls, name: str, bytes_per_sample: int, dtype: str, full_scale: float) -> Self:
        """Make a member."""
        member = object.__new__(cls)
        member._value_ = name
        member.bytes_per_sample = bytes_per_sample
        member.dtype = np.dtype(dtype)
        member.full_scale = full_scale
        return member


PcmData = bytes | bytearray | memoryview | NDArray[Any]


def stored_frames(stored: PcmData, pcm_format: PcmFormat, channels: int) -> NDArray[Any]:
    """The stored samples, one row per frame: (frames, channels), for I24 (frames, channels x 3).

    A view of `stored` if the memory layout allows, else a copy.

    stored: bytes, or an array of the format's `dtype`, flat or in rows.

    UsageError: the array has another type or shape, or the bytes are not whole frames.
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
    """Fill `frames`, (frames, channels) float32, from as many rows of `stored_frames`.

    Exact up to 24 bits; i32 is rounded to the nearest float32. Float frames keep every bit.
    """
    if pcm_format is PcmFormat.FLOAT:
        frames[...] = rows
    elif pcm_format is PcmFormat.U8:
        np.subtract(rows, np.float32(128.0), out=frames)
        frames *= np.float32(1.0 / pcm_format.full_scale)
    elif pcm_format is PcmFormat.I24:
        triples = rows.reshape(len(rows), frames.shape[1], 3)
        words = np.zeros((*frames.shape, 4), np.uint8)
        # into the upper bytes, so that the sign bit is the sign bit of int32
        words[..., 1:] = triples
        np.multiply(words.view("<i4")[..., 0], np.float32(2.0**-31), out=frames, casting="unsafe")
    else:
        # a power of two: exact in float64, so rounding happens only when stored
        np.multiply(rows, 1.0 / pcm_format.full_scale, out=frames, casting="unsafe")


def decode(stored: PcmData, pcm_format: PcmFormat, channels: int) -> Float32Array:
    """The frames stored, (frames, channels) float32, full scale ±1; raises as `stored_frames`."""
    rows = stored_frames(stored, pcm_format, channels)
    frames = np.empty((len(rows), channels), np.float32)
    decode_rows(rows, pcm_format, frames)
    return frames


def encode(frames: NDArray[np.floating[Any]], pcm_format: PcmFormat) -> bytes:
    """The frames as a sink of that format stores them: clamped, rounded, never dithered.

    Integers: round(clip(x 2^n, -2^n, 2^n - 1)) with n = 7, 15, 23, 31, half away from zero; u8 lies
    around 128. Float: clamped at ±2.0. NaN is stored as 0.
    """
    if pcm_format is PcmFormat.FLOAT:
        clamped = np.clip(frames, -FLOAT_LIMIT, FLOAT_LIMIT).astype("<f4")
        return np.where(np.isnan(clamped), np.float32(0.0), clamped).tobytes()
    whole, rest = np.empty(frames.shape), np.empty(frames.shape)
    whole_steps(frames, pcm_format.full_scale, whole, rest, np.empty(frames.shape, np.bool_))
    if pcm_format is PcmFormat.U8:
        return (whole + 128.0).astype(np.uint8).tobytes()
    if pcm_format is PcmFormat.I24:
        words = whole.astype("<i4").reshape(-1, 1).view(np.uint8)
        return words[:, :3].tobytes()
    return whole.astype(pcm_format.dtype).tobytes()
