"""The mix of one player session, which passes the session's effects, then joins the whole mix."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer.mix_buffer import MixBuffer
from audioflinger_hook.mixer.track_mixer import Lane

TAIL_S = 1.0
"""Seconds of zeros that a chain gets after its last track, so that its effects can decay."""


class SessionMix:
    """The tracks of one session, mixed. Use from the mixer's thread."""

    def __init__(self, samplerate: int, frames: int, channels: int, haptic_channels: int) -> None:
        self.buffer = MixBuffer(frames, channels, haptic_channels)
        self._tail_whole = round(TAIL_S * samplerate)
        self._tail_left = 0
        self._empty = True

    def add(self, lane: Lane, scratch: NDArray[np.float32]) -> None:
        """Add one track that is ready."""
        lane.mix(self.buffer.audio, scratch, first=self._empty)
        self._empty = False

    def hold(self, frames: int) -> None:
        """Begin a cycle of `frames` frames. Call it before the tracks."""
        self.buffer.hold(frames)

    def begin(self) -> bool:
        """Prepare the buffer for the effects; return False if the effects' tail is over.

        Call once per cycle, after the tracks.
        """
        self.buffer.haptic[...] = 0.0
        if not self._empty:
            self._empty = True
            self._tail_left = self._tail_whole
            return True
        self.buffer.audio[...] = 0.0
        if self._tail_left <= 0:
            return False
        self._tail_left -= self.buffer.frames
        return True

    def clear(self) -> None:
        """Forget the session's sound and its tail, for standby."""
        self.buffer.clear()
        self._empty = True
        self._tail_left = 0
