"""Full scale kept smoothly: partials are scaled down before they sound, the rest is rounded off.

The amplitudes of the next hop are known before it is played, and their sum bounds the wave. So
the limiter looks ahead for nothing, changes gain as slowly as any amplitude, and makes no
distortion. What little can still overshoot (the low-pass rings at a sudden start) meets a knee.
"""

from __future__ import annotations

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray

CEILING = 0.98
"""Largest sum of a hop's amplitudes; a full-scale tone keeps its level within 0.2 dB."""

KNEE = 0.985
"""Samples up to here pass as they are; above, they approach full scale and never reach it."""


def limited_amplitudes(amplitude: FloatArray) -> tuple[FloatArray, bool]:
    """Return one hop's amplitudes, scaled so that they sum to `CEILING` at most, and whether."""
    total = float(amplitude.sum())
    if total <= CEILING:
        return amplitude, False
    return amplitude * (CEILING / total), True


def below_full_scale(vibration: FloatArray) -> tuple[FloatArray, int]:
    """Return the samples with those beyond the knee rounded off, and how many there were."""
    size = np.abs(vibration)
    if size.max(initial=0.0) <= KNEE:
        return vibration, 0
    room = 1.0 - KNEE
    over = size > KNEE
    rounded = KNEE + room * np.tanh((size - KNEE) / room) * (1.0 - 1e-6)
    return np.where(over, np.copysign(rounded, vibration), vibration), int(over.sum())
