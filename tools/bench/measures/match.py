"""How well a vibration follows the loudness of its sound over time.

The measure was chosen with Sound2Hap, a set of 4000 clips whose vibrations people have rated. Of
all tested measures, it predicts these ratings best.
"""

from __future__ import annotations

import numpy as np

from audioflinger_hook.transform import FloatArray

PIECE_S = 0.02
LATEST_S = 0.08
CHANGING = 0.5  # smallest coefficient of variation of a loudness that counts as changing
POOR = 70.0


def pieces_rms(signal: FloatArray, samplerate: int) -> FloatArray:
    """Return the r.m.s. of each complete piece of 20 ms of a signal."""
    frames = round(PIECE_S * samplerate)
    pieces = signal[: signal.size // frames * frames].reshape(-1, frames)
    rms: FloatArray = np.sqrt((pieces**2).mean(axis=1))
    return rms


def match(sone: FloatArray, rms: FloatArray) -> float:
    """Return how well the vibration follows the loudness; 100 is best.

    The result is 100 (1 - (1 - r) min(1, v / 0.5)). Here r is the largest Pearson correlation of
    `sone` and `rms`, for lags of the loudness from 0 to 80 ms behind the vibration. The value v is
    the coefficient of variation of the loudness, so a steady sound requires little correlation.
    Computed loudness lags behind its sound by about 20 ms, so it lags even behind a vibration
    without delay.

    sone: mean loudness for each 20 ms.
    rms: r.m.s. of the vibration for each 20 ms.
    """
    count = min(sone.size, rms.size)
    sone, rms = sone[:count], rms[:count]
    mean = float(sone.mean()) if count else 0.0
    if mean <= 0.0:
        return 100.0
    found = []
    for late in range(1 + round(LATEST_S / PIECE_S)):
        one, other = sone[late:], rms[: count - late]
        if one.size > 2 and one.std() > 0.0 and other.std() > 0.0:
            found.append(float(np.corrcoef(one, other)[0, 1]))
    r = max(found, default=0.0)
    return 100.0 * (1.0 - (1.0 - r) * min(1.0, float(sone.std()) / mean / CHANGING))
