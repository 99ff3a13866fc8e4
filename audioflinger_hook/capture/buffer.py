"""One buffer as a capture gives it back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


# eq=False: comparing arrays with == gives arrays, so a generated __eq__ could only fail.
@dataclass(frozen=True, eq=False)
class CaptureBuffer:
    """A buffer exactly as it was delivered.

    frames: (frames, channels) float32, may be empty, belongs to whoever reads it; samplerate: Hz;
    time_s: when it was delivered, in seconds of the recorder's monotonic clock; discontinuity:
    frames are missing before it, because the source said so, because the recorder could not keep
    up, or because they were lost from the capture since.
    """

    frames: NDArray[np.float32]
    samplerate: int
    time_s: float
    discontinuity: bool

    @property
    def channels(self) -> int:
        """Number of channels."""
        return int(self.frames.shape[1])

    @property
    def format(self) -> tuple[int, int]:
        """Samplerate in Hz and number of channels."""
        return self.samplerate, self.channels
