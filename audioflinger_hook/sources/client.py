"""The interface of everything that plays into the mixer."""

from __future__ import annotations

from typing import Protocol

from audioflinger_hook.mixer import Mixer


class Client(Protocol):
    """Fills tracks of one mixer and paces its cycles. Held by the thread that steps the chain."""

    samplerate: int
    channels: int
    """Format of a mix that suits its sound, Hz and channels."""

    @property
    def frames_expected(self) -> int | None:
        """Frames of the mix in all, where that is known; for progress only."""
        ...

    def connect(self, mixer: Mixer) -> None:
        """Make its tracks. Called once, before the first `play`."""
        ...

    def play(self) -> int | None:
        """Write the sound of the next cycle and return its frames; 0: not yet, None: the end."""
        ...

    def close(self) -> None:
        """Let go of the source. May be called more than once."""
        ...
