"""Shared units and array types. Pure functions; any thread may call them."""

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from device.errors import InternalError

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
Block = TypeVar("Block", FloatArray, Float32Array)  # vibration, (frames, channels)

Record = int | float | FloatArray
Records = dict[str, Record]  # counts, numbers and tables of a design, by name


def check_channels(block: FloatArray | Float32Array, channels: int) -> None:
    """Raise InternalError unless the block has the shape (frames, channels)."""
    if block.ndim != 2 or block.shape[1] != channels:
        raise InternalError(f"a block has shape {block.shape}: (frames, {channels}) was expected")


def amplitude_to_db(ratio: float) -> float:
    """Return the level in dB of an amplitude ratio: 20 log10 |ratio| (ISO 80000-3); -inf for 0."""
    return 20.0 * math.log10(abs(ratio)) if ratio else -math.inf


def db_to_amplitude(level_db: float) -> float:
    """Return the amplitude ratio of a level in dB: 10^(level_db / 20); 0 for -inf."""
    return math.pow(10.0, level_db / 20.0)


def finite_or_zero(
    samples: FloatArray, limit: float = float(np.finfo(np.float64).max)
) -> tuple[FloatArray, int]:
    """Return the samples, and the number of samples that were replaced by 0.

    NaN and magnitudes above `limit` are replaced. If nothing is replaced, the given array itself is
    returned. The given array is never changed.
    """
    sound = np.abs(samples) <= limit  # False for NaN
    replaced = samples.size - int(np.count_nonzero(sound))
    return (np.where(sound, samples, 0.0), replaced) if replaced else (samples, 0)
