"""How loud it is: peak and RMS of blocks as they pass, in dBFS."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from device.blocks import peak
from device.units import Float32Array, amplitude_to_db

FLOOR_DBFS = -150.0
"""Silence; anything below is shown as this, so that every level is a number."""

RMS_TIME_S = 0.3
"""Time constant of the RMS."""

PEAK_FALL_DB_PER_S = 20.0
"""How fast a peak falls back."""

_BELOW = math.pow(10.0, (FLOOR_DBFS - 1.0) / 20.0)


@dataclass(frozen=True)
class Level:
    """Peak and RMS in dBFS: 0 is a sample of 1.0 (peak) or a square wave of it (RMS)."""

    peak_dbfs: float = FLOOR_DBFS
    rms_dbfs: float = FLOOR_DBFS


class LevelMeter:
    """Peak and RMS over all channels of what passed last.

    The peak rises at once and falls by 20 dB a second; the RMS follows within 0.3 s. Both depend
    on the frames alone, on no clock and on nobody's reading. One thread (the audio thread may)
    calls `add`, which makes no arrays of the block's size; any thread may call `level`.

    unusable_blocks: blocks left out because of samples that are not finite.
    """

    def __init__(self, samplerate: float) -> None:
        if not samplerate > 0.0:
            raise ValueError(f"a samplerate of {samplerate} Hz; allowed: above 0")
        self._rms_rate = -1.0 / (RMS_TIME_S * samplerate)
        self._fall_rate = -PEAK_FALL_DB_PER_S * math.log(10.0) / (20.0 * samplerate)
        self._reading = (0.0, 0.0)  # one object, so that a reader never sees half of it
        self.unusable_blocks = 0

    def add(self, block: Float32Array) -> float:
        """Take in a block, (frames, channels) or (frames,), of any length; return its peak."""
        if not block.size:
            return 0.0
        frames = len(block)
        loudest = peak(block)
        axes = "ij,ij->" if block.ndim == 2 else "i,i->"
        square = float(np.einsum(axes, block, block, dtype=np.float64)) / block.size
        if not math.isfinite(square + loudest):
            self.unusable_blocks += 1
            return loudest
        held, mean = self._reading
        keep = math.exp(frames * self._rms_rate)
        held = max(loudest, held * math.exp(frames * self._fall_rate))
        # Below the floor is 0: endless silence must not end in denormals.
        mean = keep * mean + (1.0 - keep) * square
        self._reading = (held if held > _BELOW else 0.0, mean if mean > _BELOW**2 else 0.0)
        return loudest

    def reset(self) -> None:
        """Begin anew, with silence; for the thread that calls `add`."""
        self._reading = (0.0, 0.0)

    def level(self) -> Level:
        """Return the level now, FLOOR_DBFS or more."""
        peak, mean = self._reading
        return Level(_dbfs(peak), _dbfs(math.sqrt(mean)))


def _dbfs(amplitude: float) -> float:
    return max(FLOOR_DBFS, amplitude_to_db(amplitude))
