"""The crossfade where the model of the actuator changes."""

import numpy as np

from device.units import FloatArray

_MIN_FADE_FRAMES = 16
"""A crossfade of fewer frames is not shortened any further."""
_JUMP_MARGIN = 1.25  # the old model may deviate by this multiple of the jump at the edge


def crossfade(values: FloatArray, old: FloatArray, allowed_share: float) -> None:
    """Fade from the old model's values to the new one's, in place.

    When the model changes, excursion, speed and flux continue, but acceleration and current jump by
    the old model's error. So the old model goes on past the edge and is faded out. If it deviates
    by more than `allowed_share` of the peak, the fade is halved until it fits.

    values: (frames,) of the new model. old: the first of them by the old model, at most as many.
    """
    frames = len(old)
    apart = old - values[:frames]
    allowed = max(allowed_share * float(np.abs(values).max()), _JUMP_MARGIN * abs(float(apart[0])))
    while True:
        faded = apart[:frames] * _fade_weight(frames)
        if frames < _MIN_FADE_FRAMES or float(np.abs(faded).max()) <= allowed:
            break
        frames //= 2
    values[:frames] += faded


def _fade_weight(frames: int) -> FloatArray:
    """Return (frames,) from 1 to 0: the integral of a Hann window, -60 dB above 8 / T."""
    t = np.arange(1, frames + 1) / frames
    return np.asarray(1.0 - t + np.sin(2.0 * np.pi * t) / (2.0 * np.pi))
