"""The mono mix of a sound's channels, in which opposite channels (L = -R) do not cancel.

Let l and r, the halves, be weighted sums of the left and of the right channels. Let m be
(l + r) / 2, and s be (l - r) / 2. The mean power of l and r is the power of m plus that of s.
If the power of m is under `CANCELS_FROM` times this mean, the mix is m + f s, with f from 0 to 1.
"""

import math

import numpy as np
import scipy

from audioflinger_hook.transform.arrays import FloatArray
from device.layouts import KNOWN, downmix

GROUP_FRAMES = 16  # powers are averaged over groups of frames, which saves computing time
POWER_S = 0.05  # time constant of the averages of the powers of m and s

NEWEST_S, EVIDENCE_S, EVIDENCE_FRAMES = 0.000_25, 0.000_062_5, 3
"""Time constant of the newest power, and shortest duration of cancellation in seconds and frames.
The first samples of a sound can be opposite by chance. When opposite channels start, the factor
rises after 0.7 ms and reaches 1 after 3 ms."""

CANCELS_FROM, CANCELS_UP_TO = 0.1, 0.025
"""Shares of m in the power of both halves, -10 and -16 dB, for factors of 0 and 1. With independent
channels of equal power, m has a share of 0.5."""

POWER_GUARD = 1e-25  # added before squaring, to avoid slow subnormal numbers


def mix_weights(halves: FloatArray) -> FloatArray:
    """Return each channel's weights in m and s, (2, channels), from its weights in l and r."""
    left, right = halves.T
    return np.stack((0.5 * (left + right), 0.5 * (left - right)))


def source_mixes(weights: FloatArray) -> list[FloatArray]:
    """Return `mix_weights` of each mono mix. weights: weights in l and r, (channels, mixes, 2)."""
    return [mix_weights(weights[:, source]) for source in range(weights.shape[1])]


def downmix_table() -> FloatArray:
    """Return the number of channels and `mix_weights` of each known layout, except mono."""
    rows = [mix_weights(downmix(channels)).reshape(-1) for channels in KNOWN if channels > 1]
    return np.concatenate([np.concatenate(([row.size / 2], row)) for row in rows])


def cancellation_shares(samplerate: int) -> tuple[float, float, float]:
    """Return three constants of `MonoMix` for a samplerate in Hz.

    The first two are the weights of a new group of frames in exponential averages of power with the
    time constants `POWER_S` and `NEWEST_S`. The third is the share of the shorter average that is
    added to m's power.
    """
    frames = max(EVIDENCE_FRAMES, EVIDENCE_S * samplerate)
    return (
        -math.expm1(-GROUP_FRAMES / (POWER_S * samplerate)),
        -math.expm1(-GROUP_FRAMES / (NEWEST_S * samplerate)),
        min(0.5 * CANCELS_UP_TO, frames / (POWER_S * samplerate)),
    )


class MonoMix:
    """The mono mix of a stream. Block sizes do not affect the result.

    The factor f is computed after each group of frames, and interpolated over the next group.
    halves: weights of each channel in l and r, (channels, 2).
    """

    def __init__(self, halves: FloatArray, samplerate: int) -> None:
        mean, side = mix_weights(halves)
        self._mean, self._side = _routes(mean), _routes(side)
        self._slow, self._newest, self._evidence = cancellation_shares(samplerate)
        self.reset()

    def reset(self) -> None:
        """Start a new stream."""
        self._powers = np.zeros((3, 1))
        self._factors = np.zeros(2)  # factors at the start and at the end of the current group
        self._begun = np.zeros((2, 0))  # squares of the current, incomplete group

    def process(self, rows: FloatArray) -> FloatArray:
        """Return the mono mix, (frames,), of finite samples, (channels, frames)."""
        mono = _sum(rows, self._mean)
        if not self._side or not mono.size:
            return mono
        side = _sum(rows, self._side)
        done = self._begun.shape[1]
        factors = self._note(np.square(np.stack((mono, side)) + POWER_GUARD))
        if not factors.any():
            return mono
        group, frame = np.divmod(done + np.arange(mono.size), GROUP_FRAMES)
        start, end = factors[group], factors[group + 1]
        factor = start + (end - start) * ((frame + 1.0) / GROUP_FRAMES)
        return np.where(factor > 0.0, mono + factor * side, mono)

    def _note(self, squares: FloatArray) -> FloatArray:
        """Return the factors f at the start of the current group and at the end of each group."""
        squares = np.concatenate((self._begun, squares), axis=1)
        groups = squares.shape[1] // GROUP_FRAMES
        whole = squares[:, : groups * GROUP_FRAMES].reshape(2, groups, GROUP_FRAMES)
        self._begun = squares[:, groups * GROUP_FRAMES :]
        found = self._factors
        if groups:
            power = whole[:, :, 0]
            for frame in range(1, GROUP_FRAMES):
                power = power + whole[:, :, frame]
            of_mean, of_side = power / GROUP_FRAMES  # mean powers of m and s in each group
            mean = self._smooth(0, self._slow, of_mean)
            both = mean + self._smooth(1, self._slow, of_side)
            mean = mean + self._evidence * self._smooth(2, self._newest, of_mean + of_side)
            most = np.clip((CANCELS_FROM - mean / both) / (CANCELS_FROM - CANCELS_UP_TO), 0.0, 1.0)
            found = np.concatenate((found, most * most * (3.0 - 2.0 * most)))
            self._factors = found[-2:]
        return found

    def _smooth(self, which: int, newest: float, power: FloatArray) -> FloatArray:
        smoothed, self._powers[which] = scipy.signal.lfilter(
            [newest], [1.0, newest - 1.0], power, zi=self._powers[which]
        )
        return np.asarray(smoothed)


def _routes(weights: FloatArray) -> list[tuple[int, float]]:
    return [(int(channel), float(weights[channel])) for channel in np.flatnonzero(weights)]


def _sum(rows: FloatArray, routes: list[tuple[int, float]]) -> FloatArray:
    # The order of additions is fixed, so the rounding does not depend on the block size.
    (first, weight), *others = routes
    total: FloatArray = rows[first] * weight
    for channel, weight in others:
        total += rows[channel] * weight
    return total
