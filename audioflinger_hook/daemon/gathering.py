"""What is only watched, not played, looked at in larger pieces: it costs less then."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.service.levels import LevelMeter
from device.units import Float32Array

GATHERED_S = 0.04
"""How much is gathered: levels and the moment of the last sound are that late."""


class Gathered:
    """The level of frames as they pass, gathered. One thread calls `add`; any may read `meter`.

    loudest: magnitude of the loudest sample gathered last; whole: whether the last `add` made
    it so.
    """

    def __init__(self, samplerate: int, channels: int) -> None:
        self.meter = LevelMeter(samplerate)
        self.loudest = 0.0
        self.whole = False
        self._frames = np.zeros((max(1, round(GATHERED_S * samplerate)), channels), np.float32)
        self._held = 0

    def add(self, frames: Float32Array) -> None:
        """Take (frames, channels), any number of frames; they are copied."""
        held = self._held + len(frames)
        if held <= len(self._frames):
            self._frames[self._held : held] = frames
            self._held = held
            self.whole = False
            return
        self._look(self._frames[: self._held])
        if len(frames) > len(self._frames):
            self._look(frames)
            frames = frames[:0]
        self._held = len(frames)
        self._frames[: self._held] = frames
        self.whole = True

    def reset(self) -> None:
        """Begin anew with silence; for the thread that calls `add`, or while none does."""
        self._held = 0
        self.loudest = 0.0
        self.meter.reset()

    def _look(self, frames: Float32Array) -> None:
        if len(frames):
            self.meter.add(frames)
            self.loudest = max(float(frames.max()), -float(frames.min()))
