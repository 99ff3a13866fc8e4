"""The crossfade where the model of the actuator changes."""

from functools import lru_cache

import numpy as np

from device.units import FloatArray

_MIN_FADE_FRAMES = 16
"""A crossfade of fewer frames is not shortened any further."""
_JUMP_MARGIN = 1.25  # the old model may deviate by this multiple of the jump at the edge


def crossfade(values: FloatArray, old: FloatArray, allowed_share: float) -> None:
    """Fade from the old model's values to the new one's, in place.

    When the model changes, excursion, speed and flux continue, but acceleration and current jump by
    the old model's error. So the old model goes on past the edge and is faded out. If it deviates
    by more than `allowed_share` of a row's peak, the fade is halved until it fits.

    values: (rows, frames) of the new model. old: the first of them by the old model.
    """
    frames = old.shape[1]
    apart = old - values[:, :frames]
    peaks = np.maximum(values.max(axis=1), -values.min(axis=1))
    allowed = np.maximum(allowed_share * peaks, _JUMP_MARGIN * np.abs(apart[:, 0]))
    while True:
        faded = apart[:, :frames] * _fade_weight(frames)
        if frames < _MIN_FADE_FRAMES or (np.abs(faded).max(axis=1) <= allowed).all():
            break
        frames //= 2
    values[:, :frames] += faded


@lru_cache(maxsize=32)
def _fade_weight(frames: int) -> FloatArray:
    """Return (frames,) from 1 to 0: the integral of a Hann window, -60 dB above 8 / T."""
    t = np.arange(1, frames + 1) / frames
    return np.asarray(1.0 - t + np.sin(2.0 * np.pi * t) / (2.0 * np.pi))
