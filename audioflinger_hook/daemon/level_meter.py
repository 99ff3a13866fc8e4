"""What is only watched, not played, looked at in larger pieces: it costs less then."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.service.levels import LevelMeter
from device.units import Float32Array

GATHERED_S = 0.06
"""How much is gathered at least: levels and the moment of the last sound are that late."""


class BufferedLevelMeter:
    """The level of frames as they pass, gathered. One thread calls `add`; any may read `meter`.

    loudest: magnitude of the loudest sample gathered last; whole: whether the last `add` made
    it so.
    """

    def __init__(self, samplerate: int) -> None:
        self.meter = LevelMeter(samplerate)
        self.loudest = 0.0
        self.whole = False
        self._enough = max(1, round(GATHERED_S * samplerate))
        self._blocks: list[Float32Array] = []
        self._held = 0

    def add(self, frames: Float32Array) -> None:
        """Take (frames, channels), any number of frames; they must not change any more."""
        self._blocks.append(frames)
        self._held += len(frames)
        self.whole = self._held >= self._enough
        if self.whole:
            self.loudest = self.meter.add(np.concatenate(self._blocks))
            self._forget()

    def reset(self) -> None:
        """Begin anew with silence; for the thread that calls `add`, or while none does."""
        self._forget()
        self.loudest = 0.0
        self.meter.reset()

    def _forget(self) -> None:
        self._blocks.clear()
        self._held = 0
