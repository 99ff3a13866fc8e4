"""The nodes of the non-linear models between samples, and interpolation back to samples.

Nodes, and middles between them, lie on samples at any sample rate. If samples are too far apart,
the voltage is upsampled along its straight lines, which changes nothing.
"""

from functools import cache

import numpy as np

from device.units import FloatArray

NODES_HZ = 6_000.0
_FINEST = 4
"""Least samples between nodes: spacing is halved for the stops, and there are middles."""


class NodeGrid:
    """The grid for one sample rate, Hz; its node rate is within a factor of 1.5 of nodes_hz."""

    def __init__(self, samplerate: float, nodes_hz: float = NODES_HZ) -> None:
        self.upsampling = max(1, int(np.ceil(_FINEST * nodes_hz / samplerate)))
        self.samplerate = samplerate * self.upsampling
        # Grid samples from node to node, a multiple of 4.
        self.spacing = _FINEST * max(1, round(self.samplerate / (_FINEST * nodes_hz)))
        self.reset()

    def reset(self) -> None:
        """Set the last sample to 0."""
        self._last_v = 0.0

    def upsample(self, volts: FloatArray) -> FloatArray:
        """Return (frames * upsampling,) on the straight lines between samples."""
        if self.upsampling == 1 or not len(volts):
            return volts
        before = np.concatenate([[self._last_v], volts[:-1]])
        self._last_v = float(volts[-1])
        shares = np.arange(1, self.upsampling + 1) / self.upsampling
        return np.asarray(before[:, None] + (volts - before)[:, None] * shares).reshape(-1)


def interpolate_cubic(
    nodes: FloatArray, rates: FloatArray, step_s: float, spacing: int
) -> FloatArray:
    """Return (steps * spacing,) samples after the first node of a cubic through nodes and rates."""
    known = np.stack([nodes[:-1], nodes[1:], step_s * rates[:-1], step_s * rates[1:]], axis=1)
    return np.asarray(known @ _bases(spacing)[0]).reshape(-1)


def interpolate_quadratic(nodes: FloatArray, middles: FloatArray, spacing: int) -> FloatArray:
    """Return (steps * spacing,) samples after the first node of parabolas through three points."""
    known = np.stack([nodes[:-1], middles, nodes[1:]], axis=1)
    return np.asarray(known @ _bases(spacing)[1]).reshape(-1)


@cache
def _bases(spacing: int) -> tuple[FloatArray, FloatArray]:
    """Return the cubic and the quadratic basis at the samples of one step."""
    t = np.arange(1, spacing + 1) / spacing
    rise = t * t * (3.0 - 2.0 * t)
    cubic = np.array([1.0 - rise, rise, t * (1.0 - t) ** 2, -t * t * (1.0 - t)])
    return cubic, np.array([(1.0 - t) * (1.0 - 2.0 * t), 4.0 * t * (1.0 - t), t * (2.0 * t - 1.0)])
