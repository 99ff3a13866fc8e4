"""The interfaces of taps, which deliver sound, and of clients, which play it into the mixer."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer import Mixer


class Tap(Protocol):
    """A source of sound: buffers in order, until it ends."""

    samplerate: int
    channels: int
    """Format of the buffer read last; before the first buffer, the format of the first."""

    format_changed: bool
    """Whether the format of the buffer read last differs from the format before."""

    discontinuity: bool
    """Whether frames are missing before the buffer read last."""

    @property
    def frames_expected(self) -> int | None:
        """Total number of frames, if known; only for showing progress."""
        ...

    def read(self) -> NDArray[np.float32] | None:
        """Return the next buffer, (frames, channels) float32, or None when the sound has ended.

        Called by the thread that steps the chain.
        """
        ...

    def close(self) -> None:
        """Let go of the source. May be called more than once."""
        ...


class Client(Protocol):
    """Fills tracks of one mixer and paces its cycles. Use from the thread that steps the chain."""

    samplerate: int
    channels: int
    """Format of a mix that suits the client's sound: Hz and channels."""

    @property
    def frames_expected(self) -> int | None:
        """Total frames of the mix, if known; only for showing progress."""
        ...

    def connect(self, mixer: Mixer) -> None:
        """Make the client's tracks. Called once, before the first `play`."""
        ...

    def play(self) -> int | None:
        """Write the sound of the next cycle and return its frames; 0: none yet, None: the end."""
        ...

    def close(self) -> None:
        """Let go of the source. May be called more than once."""
        ...
