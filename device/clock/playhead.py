"""Where a ring of frames is read, at any ratio and without a click."""

from __future__ import annotations

from device.clock.declick import Joint
from device.clock.interpolator import CubicReader
from device.clock.ring import NewestFrames
from device.units import Float32Array


class Playhead:
    """The place in a ring of which the next frame is played. Called by the reading thread.

    ring: what is read; samplerate: of what comes out, Hz; channels: of both.
    """

    def __init__(self, ring: NewestFrames, samplerate: float, channels: int) -> None:
        self._ring = ring
        self._reader = CubicReader(ring.frames)
        self._joint = Joint(samplerate, channels)

    def behind(self, frames: float) -> float:
        """How far it is behind that count of frames."""
        return frames - self._reader.position - self._reader.fraction

    @property
    def overtaken(self) -> bool:
        """Whether what is to be played next was overwritten."""
        return self._reader.position - 1 < self._ring.oldest

    def readable(self, written: int, step: float) -> int:
        """How many frames can be played at `step`, with `written` frames in the ring."""
        return self._reader.readable(written, step)

    def jump_to(self, position: int) -> None:
        """Go to a frame."""
        self._reader.jump_to(position)

    def join(self) -> None:
        """Let the next frame be the first of another piece, or of silence."""
        self._joint.begin()

    def play(self, out: Float32Array, step: float) -> bool:
        """Fill with readable frames; False where the writer overtook while they were read."""
        first = self._reader.position - 1
        self._reader.read(out, step)
        if first < self._ring.oldest:
            return False
        self._joint.apply(out)
        return True

    def fall_silent(self, out: Float32Array) -> None:
        """Fill with silence, that what was played before fades into."""
        out[:] = 0.0
        self._joint.apply(out)

    def cut(self, out: Float32Array) -> None:
        """Fill with silence from the first frame on; what comes next rises from it."""
        out[:] = 0.0
        self._joint.cut()
