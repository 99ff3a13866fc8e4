"""Whether a vibration alone tells what is heard: nearest neighbours of a few plain features."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from audioflinger_hook.transform import FloatArray

FRAME_S = 0.05
HIGHEST_HZ = 250.0
WITHIN_DB = 40.0
"""Frames weaker than that under the strongest one do not count."""
NEIGHBOURS = 5
LEAST_SPREAD = 0.1
"""A feature that varies less over the sounds, in dB or Hz, is not felt and does not count."""


def features(vibration: FloatArray, samplerate: int) -> FloatArray:
    """Return six numbers: mean, spread and modulation of level and centroid of 50 ms frames.

    The level is in dB, the centroid in Hz, up to 250 Hz; modulation is the mean step from one frame
    to the next. Silence gives zeros.
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
    """Return the share of sounds whose class their nearest neighbours have, %.

    It is the mean over classes, so that chance gives 100 over their number. found: (sounds,
    features); each sound is judged by the five nearest others, and the nearest of these decides
    where two classes are as frequent. Features are scaled to a spread of 1; those with less than
    0.1 dB or Hz are left out.
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
