"""How well a classifier recognises the class of a sound from its vibration alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from audioflinger_hook.transform import FloatArray

FRAME_S = 0.05
HIGHEST_HZ = 250.0
WITHIN_DB = 40.0  # pieces weaker than the strongest by more than this, in dB, are ignored
NEIGHBOURS = 5
LEAST_SPREAD = 0.1  # spread in dB or Hz below which a feature is imperceptible and ignored


def features(vibration: FloatArray, samplerate: int) -> FloatArray:
    """Return six features of a vibration: three of its level, and three of its spectral centroid.

    Level (in dB) and centroid (of frequencies up to 250 Hz, in Hz) are computed for each piece of
    50 ms. The features are the mean, the standard deviation and the mean absolute difference
    between consecutive pieces, of both quantities. Pieces that are more than 40 dB weaker than the
    strongest piece are ignored. Silence gives zeros.
    """
    frames = round(FRAME_S * samplerate)
    pieces = vibration[: vibration.size // frames * frames].reshape(-1, frames)
    power = (pieces**2).mean(axis=1)
    strong = power > power.max(initial=0.0) * 10.0 ** (-WITHIN_DB / 10.0)
    if not strong.any():
        return np.zeros(6)
    spectrum = np.abs(np.fft.rfft(pieces[strong] * np.hanning(frames), axis=1)) ** 2
    hz = np.fft.rfftfreq(frames, 1.0 / samplerate)
    low = hz <= HIGHEST_HZ
    centroid = spectrum[:, low] @ hz[low] / np.maximum(spectrum[:, low].sum(axis=1), 1e-30)
    level = 10.0 * np.log10(power[strong])
    return np.array([number for each in (level, centroid) for number in _three(each)])


def _three(series: FloatArray) -> tuple[float, float, float]:
    moved = float(np.abs(np.diff(series)).mean()) if series.size > 1 else 0.0
    return float(series.mean()), float(series.std()), moved


def told_apart(found: FloatArray, kinds: Sequence[str]) -> float:
    """Return the share of sounds whose class is found correctly from the features, in %.

    The five sounds with the nearest features vote for a class. In a tie, the nearest sound decides.
    Features whose standard deviation is at most 0.1 (dB or Hz) are ignored. The other features are
    scaled to a standard deviation of 1. The result is the mean of the shares of all classes.

    found: (sounds, features).
    kinds: class of each sound.
    """
    spread = found.std(axis=0)
    scaled = ((found - found.mean(axis=0)) / np.maximum(spread, LEAST_SPREAD)) * (
        spread > LEAST_SPREAD
    )
    distance = np.linalg.norm(scaled[:, None] - scaled[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    names = np.array(kinds)
    right = np.zeros(len(names), bool)
    for one, row in enumerate(distance):
        near = names[np.argsort(row, kind="stable")[:NEIGHBOURS]].tolist()
        right[one] = max(near, key=lambda kind: (near.count(kind), -near.index(kind))) == names[one]
    return 100.0 * float(np.mean([right[names == kind].mean() for kind in np.unique(names)]))
