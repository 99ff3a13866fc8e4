"""From one rung to the next without a click.

Where a rung follows another, or a correction itself, whose remainder is another one in each block,
x, v and flux go on as they are, but acceleration and current jump by what the rung before was off.
So that one is continued beyond the edge and faded out, with a weight whose slope and curvature are
0 at both ends. Whatever leaves the old rung's path at once, be it only its slope, clicks.
"""

import numpy as np

from device.units import FloatArray

_SHORTEST = 8
"""Samples of a fade that is cut short for the sake of the tolerance."""
_OVER_THE_JUMP = 1.25
"""The jump at the edge is there in any case; the old rung may be off by so much of it later on."""


def fade(
    values: FloatArray, old: FloatArray, base: FloatArray | None, allowed_share: float
) -> None:
    """From what went on before to what is chosen now, in place.

    values: what the new rung adds to base, (frames,); old: the same of the old rung, for the first
    samples; base: the linear solution with the sample before, None for 0. allowed_share: by which
    share of the whole's peak the fade may be off.

    Where the old rung goes wrong before it is faded out, as at the beginning of a burst, it is
    faded out in half the time, and so on.
    """
    frames = len(old)
    apart = old - values[:frames]
    whole = values if base is None else values + base[1:]
    allowed = allowed_share * float(np.abs(whole).max())
    allowed = max(allowed, _OVER_THE_JUMP * abs(float(apart[0])))
    while True:
        faded = apart[:frames] * _weight(frames)
        if frames < 2 * _SHORTEST or float(np.abs(faded).max()) <= allowed:
            break
        frames //= 2
    values[:frames] += faded


def _weight(frames: int) -> FloatArray:
    """(frames,) from 1 to 0, the integral of a Hann window: 60 dB down from four times 2 / T on."""
    t = np.arange(1, frames + 1) / frames
    return np.asarray(1.0 - t + np.sin(2.0 * np.pi * t) / (2.0 * np.pi))
