"""A tap on a scene made by code."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.scenes import Scene


class SceneTap:
    """The scene's mixdown in buffers of `blocksize` frames (the last may be shorter)."""

    def __init__(self, scene: Scene, blocksize: int) -> None:
        self._frames = scene.mixdown()
        self._blocksize = blocksize
        self._position = 0
        self.samplerate = scene.samplerate
        self.channels = self._frames.shape[1]

    @property
    def frames_expected(self) -> int | None:
        """The scene's length in frames."""
        return len(self._frames)

    def read(self) -> NDArray[np.float32] | None:
        """Return the next buffer, or None after the last."""
        first = self._position
        if first >= len(self._frames):
            return None
        self._position = first + self._blocksize
        return self._frames[first : self._position]

    def close(self) -> None:
        """Nothing is held."""
