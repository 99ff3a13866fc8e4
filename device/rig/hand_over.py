"""From one rung to the next without a click."""

import numpy as np

from device.units import FloatArray


def fade(
    values: FloatArray, old: FloatArray, base: FloatArray | None, allowed_share: float
) -> None:
    """From what went on before to what is chosen now, in place.

    values: what the new rung adds to base, (frames,); old: the same of the old rung, for the first
    samples; base: the linear solution with the sample before, None for 0. allowed_share: by which
    share of the whole's peak the fade may be off.

    Where the old rung goes wrong before it is faded out, as at the beginning of a burst, only
    the jump between the two is.
    """
    frames = len(old)
    weight = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, frames + 1) / frames)
    apart = old - values[:frames]
    whole = values if base is None else values + base[1:]
    allowed = allowed_share * float(np.abs(whole).max())
    if float(np.abs(apart * weight).max()) > allowed:
        apart = np.full(frames, apart[0])
    values[:frames] += apart * weight
