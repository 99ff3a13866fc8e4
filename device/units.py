"""Units and array types that every module shares. Pure functions; any thread may call them."""

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from device.errors import InternalError

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
Block = TypeVar("Block", FloatArray, Float32Array)
"""A block of vibration, (frames, channels), of either precision."""

Record = int | float | FloatArray
Records = dict[str, Record]  # counts, numbers and tables of a design, by name


def check_channels(block: FloatArray | Float32Array, channels: int) -> None:
    """Raise InternalError unless a block has shape (frames, channels) with this many channels."""
    if block.ndim != 2 or block.shape[1] != channels:
        raise InternalError(f"a block has shape {block.shape}: (frames, {channels}) was expected")


def amplitude_to_db(ratio: float) -> float:
    """Level in dB of an amplitude ratio: 20 log10 |ratio|; -inf for 0, never a warning.

    ISO 80000-3: a root-power quantity has 20 dB per decade.
    """
    return 20.0 * math.log10(abs(ratio)) if ratio else -math.inf


def db_to_amplitude(level_db: float) -> float:
    """Amplitude ratio of a level in dB: 10^(level_db / 20); 0 for -inf."""
    return math.pow(10.0, level_db / 20.0)


def finite_or_zero(
    samples: FloatArray, limit: float = float(np.finfo(np.float64).max)
) -> tuple[FloatArray, int]:
    """Return the samples with 0 for NaN and for magnitudes above `limit`, and how many these were.

    If there are none, the array itself is returned; it is never changed.
    """
    sound = np.abs(samples) <= limit  # False for NaN
    replaced = samples.size - int(np.count_nonzero(sound))
    return (np.where(sound, samples, 0.0), replaced) if replaced else (samples, 0)
