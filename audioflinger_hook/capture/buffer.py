"""One buffer as a capture gives it back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


# eq=False: comparing arrays with == gives arrays, so a generated __eq__ could only fail.
@dataclass(frozen=True, eq=False)
class CaptureBuffer:
    """A buffer exactly as it was delivered.

    Attributes
    ----------
    frames : array of float32
        (frames, channels), possibly empty; the reader owns it.
    samplerate : int
        Hz.
    time_s : float
        Time of its delivery, seconds of the recorder's monotonic clock.
    discontinuity : bool
        Whether frames are missing before it: at the source, in the recorder or in the capture.
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
