"""Where the nodes of the non-linear levels lie between samples, and back from nodes to samples.

The nodes come at about 6 kHz whatever the sample rate: every so many samples, with the middles on
samples too, at double that rate as well (for the end stops). Where samples are too far apart for
that, the voltage gets more of them, on the straight lines that it is made of: nothing changes.
"""

from functools import cache

import numpy as np

from device.units import FloatArray

NODES_HZ = 6_000.0
_FINEST = 4
"""Samples between nodes: they are halved for the stops, and have middles."""


class NodeGrid:
    """The grid for one sample rate, Hz.

    upsampling: samples of the grid for one of the signal; spacing: samples of the grid from node
    to node, a multiple of 4; nodes_hz: wanted, reached within a factor of 1.5.
    """

    def __init__(self, samplerate: float, nodes_hz: float = NODES_HZ) -> None:
        self.upsampling = max(1, int(np.ceil(_FINEST * nodes_hz / samplerate)))
        self.samplerate = samplerate * self.upsampling
        self.spacing = _FINEST * max(1, round(self.samplerate / (_FINEST * nodes_hz)))
        self._last_v = 0.0

    def reset(self) -> None:
        """Forget the last sample: it was 0."""
        self._last_v = 0.0

    def upsampled(self, volts: FloatArray) -> FloatArray:
        """(frames * upsampling,) on the straight lines between the samples and the one before."""
        if self.upsampling == 1 or not len(volts):
            return volts
        before = np.concatenate([[self._last_v], volts[:-1]])
        self._last_v = float(volts[-1])
        shares = np.arange(1, self.upsampling + 1) / self.upsampling
        return np.asarray(before[:, None] + (volts - before)[:, None] * shares).reshape(-1)


def compensate_interpolation(volts: FloatArray) -> FloatArray:
    """(frames,) whose straight lines come as close to a smooth signal as curves through it would.

    Straight lines through the samples of a sinusoid lose (w T)^2 / 12 of it, 7e-5 at 220 Hz and
    48 kHz; a second difference puts that back, and (w T)^4 / 360, 2e-9, is left. It takes the next
    sample as well, so it is for signals that are there as a whole.
    """
    raised = volts.copy()
    raised[1:-1] -= (volts[2:] - 2.0 * volts[1:-1] + volts[:-2]) / 12.0
    return raised


def cubic(nodes: FloatArray, rates: FloatArray, step_s: float, spacing: int) -> FloatArray:
    """(steps * spacing,) samples after the first node of a cubic through nodes and their rates."""
    known = np.stack([nodes[:-1], nodes[1:], step_s * rates[:-1], step_s * rates[1:]], axis=1)
    return np.asarray(known @ _cubic_basis(spacing)).reshape(-1)


def quadratic(nodes: FloatArray, middles: FloatArray, spacing: int) -> FloatArray:
    """(steps * spacing,) samples after the first node, of parabolas through three points each."""
    known = np.stack([nodes[:-1], middles, nodes[1:]], axis=1)
    return np.asarray(known @ _quadratic_basis(spacing)).reshape(-1)


@cache
def _cubic_basis(spacing: int) -> FloatArray:
    t = np.arange(1, spacing + 1) / spacing
    rise = t * t * (3.0 - 2.0 * t)
    return np.array([1.0 - rise, rise, t * (1.0 - t) ** 2, -t * t * (1.0 - t)])


@cache
def _quadratic_basis(spacing: int) -> FloatArray:
    t = np.arange(1, spacing + 1) / spacing
    return np.array([(1.0 - t) * (1.0 - 2.0 * t), 4.0 * t * (1.0 - t), t * (2.0 * t - 1.0)])
