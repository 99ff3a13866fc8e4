"""When the next buffer is due, for sound that is not delivered by a clock of its own."""

from __future__ import annotations


class RealTimePace:
    """Due times of frames played from `start_s` on, in seconds of whatever clock the caller has."""

    def __init__(self, samplerate: int, start_s: float) -> None:
        self._samplerate = samplerate
        self._start_s = start_s

    def wait_s(self, frames: int, now_s: float) -> float:
        """Return how long to wait at `now_s` until `frames` would have been played; 0 if late."""
        return max(0.0, self._start_s + frames / self._samplerate - now_s)
