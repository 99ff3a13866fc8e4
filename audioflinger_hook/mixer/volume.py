"""Volume: one gain a channel, changed over exactly one buffer."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer.layouts import sides

SMALLEST_NORMAL = float(np.finfo(np.float32).tiny)

Gains = tuple[float, ...]


def usable_gain(gain: float) -> float:
    """The gain that is used for one asked for: 0 for NaN, negative and subnormal, at most 1."""
    # not max(0, gain): NaN has to fail this test
    return min(gain, 1.0) if gain >= SMALLEST_NORMAL else 0.0


def gains_of(volume: Sequence[float], channels: int) -> Gains:
    """One usable gain for each of `channels` of the mix, rounded to float32.

    volume: one gain for all channels; or two, left and right, whose mean the centre takes; or one
    for each channel, where the last also holds for further channels.
    """
    usable = [float(np.float32(usable_gain(gain))) for gain in volume]
    if len(usable) == 2:
        left, right = usable
        of_side = {"L": left, "R": right, "C": usable_gain(float(np.float32((left + right) * 0.5)))}
        return tuple(of_side[side] for side in sides(channels))
    return tuple(usable[min(channel, len(usable) - 1)] for channel in range(channels))


class VolumeRamp:
    """The gains with which one track enters the mix, held by the mixer's thread.

    A change goes linearly over exactly one buffer: frame i of n has old + (new - old) i/n, so the
    next buffer starts at the new gain. A track's first buffer has no ramp. frames: of the buffers
    that come most, for which the ramp is kept ready.
    """

    def __init__(self, channels: int, frames: int) -> None:
        self._rise = _rise(frames)
        self._silent: Gains = (0.0,) * channels
        self._unity: Gains = (1.0,) * channels
        self._now: Gains | None = None
        self._row = np.zeros(channels, np.float32)

    @property
    def gains(self) -> Gains | None:
        """The gains reached, one a channel; None before the first buffer."""
        return self._now

    def restart(self) -> None:
        """Make the next buffer a first one."""
        self._now = None

    def mute(self) -> None:
        """Make the next buffer rise from silence."""
        self._now = self._silent

    def mix(
        self,
        source: NDArray[np.float32],
        target: NDArray[np.float32],
        goal: Gains | None,
        scratch: NDArray[np.float32],
        *,
        first: bool,
    ) -> None:
        """Bring one whole buffer to the target: added, or written over it if it is the first.

        source: (frames, channels) or (frames, 1), only read; target, scratch: (frames,
        channels). goal: the gains to reach, None for silence. At unity gain the samples are
        copied or added bit for bit.
        """
        goal = self._silent if goal is None else goal
        now = goal if self._now is None else self._now
        self._now = goal
        if now == goal == self._unity:
            if first:
                target[...] = source
            else:
                target += source
            return
        product = target if first else scratch
        if now == goal:
            self._row[:] = goal
            np.multiply(source, self._row, out=product)
        else:
            frames = len(source)
            rise = self._rise if frames == len(self._rise) else _rise(frames)
            self._row[:] = [new - old for new, old in zip(goal, now, strict=True)]
            np.multiply(rise, self._row, out=scratch)
            self._row[:] = now
            scratch += self._row
            np.multiply(scratch, source, out=product)
        if not first:
            target += product


def _rise(frames: int) -> NDArray[np.float32]:
    """Return i/n of every frame of a buffer, as a column."""
    return (np.arange(frames, dtype=np.float64) / frames).astype(np.float32)[:, None]


def decibels(gain: float) -> float:
    """Return a gain in decibels, -inf for 0, for dumps."""
    return 20.0 * math.log10(gain) if gain > 0.0 else -math.inf
