"""The last frames that were written, for a reader that must never wait."""

from __future__ import annotations

import numpy as np

from device.blocks import peak
from device.units import Float32Array, FloatArray

LARGEST = 1e6
"""Magnitudes above it are no vibration, but a mistake that arithmetic might turn into inf."""


class NewestFrames:
    """A bounded ring that the newest frames are always in; the oldest are overwritten.

    One thread writes, one other reads, without locks. The writer announces in `claimed` what it
    is about to overwrite, stores the frames, and only then lets the reader know of them (in
    whatever the owner of the ring publishes). So the reader uses frames from `oldest` up to what
    was published, and asks `oldest` again afterwards: if that is still behind what it read, all
    of it was whole. This needs only that one attribute is stored or loaded at once and that
    stores are seen in the order they were made: CPython with a GIL switches threads between byte
    codes only, and without one attributes are loaded and stored under the object's own lock.

    frames: float32 (capacity, channels); frame k is in row k % capacity. claimed: frames that
    were or are being stored since the start. capacity: frames, allocated once.
    """

    def __init__(self, capacity: int, channels: int) -> None:
        self.frames = np.zeros((capacity, channels), np.float32)
        self.capacity = capacity
        self.claimed = 0

    @property
    def oldest(self) -> int:
        """Number of the oldest frame that is not being overwritten. Any thread may ask."""
        return self.claimed - self.capacity

    def store(self, block: Float32Array | FloatArray) -> int:
        """Store (frames, channels), any number of frames, and return the new count of frames.

        What is not finite or beyond any vibration becomes 0. Called by the writing thread.
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
        sound = np.abs(rows) <= LARGEST  # False for NaN
    if not sound.all():
        rows[~sound] = 0.0
