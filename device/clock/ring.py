"""A ring of the newest frames, for a reader that never waits."""

from __future__ import annotations

import numpy as np

from device.blocks import peak
from device.units import Float32Array, FloatArray

LARGEST = 1e6
"""Greater magnitudes are a mistake that arithmetic might turn into inf."""


class NewestFrames:
    """A bounded ring that always holds the newest frames; the oldest are overwritten.

    One thread writes and one other reads, without locks. The writer sets `claimed` to announce
    what it overwrites, stores the frames, and then publishes the new count elsewhere. The reader
    uses frames from `oldest` up to the published count and reads `oldest` again afterwards: if
    that is still behind what it used, all of it was intact. This needs atomic loads and stores of
    one attribute, seen in order. CPython has both: with a GIL it switches threads between byte
    codes only, and without one an object's lock guards its attributes.

    frames: float32 (capacity, channels); frame k is in row k % capacity. claimed: frames that
    were or are being stored since the start. capacity: in frames, allocated once.
    """

    def __init__(self, capacity: int, channels: int) -> None:
        self.frames = np.zeros((capacity, channels), np.float32)
        self.capacity = capacity
        self.claimed = 0

    @property
    def oldest(self) -> int:
        """Number of the oldest frame that is not being overwritten. Any thread may read it."""
        return self.claimed - self.capacity

    def store(self, block: Float32Array | FloatArray) -> int:
        """Store (frames, channels), any number of frames, and return the new count of frames.

        Samples that are not finite, or beyond LARGEST, become 0. Called by the writing thread.
        """
        count = len(block)
        written = self.claimed
        self.claimed = written + count
        skipped = max(0, count - self.capacity)
        block = block[skipped:]
        first = (written + skipped) % self.capacity
        before_end = min(len(block), self.capacity - first)
        _copy(block[:before_end], self.frames[first : first + before_end])
        if before_end < len(block):
            _copy(block[before_end:], self.frames[: len(block) - before_end])
        return written + count


def _copy(block: Float32Array | FloatArray, rows: Float32Array) -> None:
    if peak(block) <= LARGEST:  # False for NaN
        rows[:] = block
        return
    with np.errstate(over="ignore", invalid="ignore"):
        rows[:] = block
        valid = np.abs(rows) <= LARGEST  # False for NaN
    if not valid.all():
        rows[~valid] = 0.0
