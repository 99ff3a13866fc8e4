"""A tap on a sound made by code."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class FramesTap:
    """Frames from memory, in buffers of `blocksize`; the last may be shorter.

    Parameters
    ----------
    frames : array of float32
        (frames, channels).
    samplerate : int
        Hz.
    blocksize : int
        Frames of a buffer.
    """

    format_changed = False
    discontinuity = False

    def __init__(self, frames: NDArray[np.float32], samplerate: int, blocksize: int) -> None:
        self._frames = frames
        self._blocksize = blocksize
        self._position = 0
        self.samplerate = samplerate
        self.frames_expected, self.channels = frames.shape

    def read(self) -> NDArray[np.float32] | None:
        """Return the next buffer, or None after the last."""
        first = self._position
        if first >= len(self._frames):
            return None
        self._position = first + self._blocksize
        return self._frames[first : self._position]

    def close(self) -> None:
        """Nothing is held."""
