"""The mono mix of a sound's channels; where its halves cancel, the sum of their powers instead.

Two opposite channels (L = -R) have no mean. With the mean m of the halves and half of their
difference s, the power of both halves is that of m plus that of s. While the share of m is under
`CANCELS_FROM`, s is added to m with a factor from 0 to 1. Other sound keeps every bit of its mean.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from audioflinger_hook.transform.arrays import FloatArray
from device.layouts import KNOWN, downmix

GROUP_FRAMES = 16  # their power counts as one number, which makes the recursions cheap
POWER_S = 0.05  # time constant of the powers that are compared

NEWEST_S, EVIDENCE_S, EVIDENCE_FRAMES = 0.000_25, 0.000_062_5, 3
"""The newest power, and how long it must have lasted before it counts as cancelled: among the first
samples of any sound some are opposite by chance. From silence, opposite channels are added
from 0.6 ms on and fully after 3 ms."""

CANCELS_FROM, CANCELS_UP_TO = 0.1, 0.025
"""Shares of power in the mean where the factor begins to rise from 0, and where it reaches 1: -10
and -16 dB. Independent channels, or sound in one of them, have a share of 0.5. Reverberation and
drones in real stereo have down to 0.14 for some 0.1 s."""

POWER_GUARD = 1e-25  # added to what is squared: no power decays into denormal numbers


def mix_weights(halves: FloatArray) -> FloatArray:
    """Return (2, channels), the mean and half the difference of halves (channels, 2)."""
    left, right = halves.T
    return np.stack((0.5 * (left + right), 0.5 * (left - right)))


def source_mixes(weights: FloatArray) -> list[FloatArray]:
    """Return `mix_weights` of each source; weights: (channels, sources, 2)."""
    return [mix_weights(weights[:, source]) for source in range(weights.shape[1])]


def downmix_table() -> FloatArray:
    """Return each known layout's number of channels and `mix_weights`; others are averaged."""
    rows = [mix_weights(downmix(channels)).reshape(-1) for channels in KNOWN if channels > 1]
    return np.concatenate([np.concatenate(([row.size / 2], row)) for row in rows])


def cancellation_shares(samplerate: int) -> tuple[float, float, float]:
    """Return the numbers of the rule for one samplerate in Hz.

    Shares of a new group of frames in the powers, and in the newest power; share of the newest
    power that counts as power of the mean.
    """
    frames = max(EVIDENCE_FRAMES, EVIDENCE_S * samplerate)
    return (
        -math.expm1(-GROUP_FRAMES / (POWER_S * samplerate)),
        -math.expm1(-GROUP_FRAMES / (NEWEST_S * samplerate)),
        min(0.5 * CANCELS_UP_TO, frames / (POWER_S * samplerate)),
    )


class MonoMix:
    """The mono mix of a stream, continued from block to block; any split gives the same bytes.

    The factor on s is found from whole groups of frames, and moves evenly within the next group.
    halves: weights of each channel, (channels, 2). Use from one thread at a time.
    """

    def __init__(self, halves: FloatArray, samplerate: int) -> None:
        mean, side = mix_weights(halves)
        self._mean, self._side = _routes(mean), _routes(side)
        self._slow, self._newest, self._evidence = cancellation_shares(samplerate)
        self.reset()

    def reset(self) -> None:
        """Return to the state of a new stream."""
        self._powers = np.zeros((3, 1))
        self._factors = np.zeros(2)  # at the start and the end of the group under way
        self._begun = np.zeros((2, 0))  # squares of that group

    def process(self, rows: FloatArray) -> FloatArray:
        """Return (frames,) for usable rows (channels, frames) float64. For the audio thread."""
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
        """Return the factors at the ends of the groups that squares (2, frames) reach.

        The first is that at the start of the group under way; the last may not be reached yet.
        """
        squares = np.concatenate((self._begun, squares), axis=1)
        groups = squares.shape[1] // GROUP_FRAMES
        whole = squares[:, : groups * GROUP_FRAMES].reshape(2, groups, GROUP_FRAMES)
        self._begun = squares[:, groups * GROUP_FRAMES :]
        found = self._factors
        if groups:
            power = whole[:, :, 0]
            for frame in range(1, GROUP_FRAMES):
                power = power + whole[:, :, frame]
            found = np.concatenate((found, self._factor(*(power / GROUP_FRAMES))))
            self._factors = found[-2:]
        return found

    def _factor(self, of_mean: FloatArray, of_side: FloatArray) -> FloatArray:
        """Return the factor on s after each group, from the groups' powers."""
        mean = self._smooth(0, self._slow, of_mean)
        both = mean + self._smooth(1, self._slow, of_side)
        mean = mean + self._evidence * self._smooth(2, self._newest, of_mean + of_side)
        most = np.clip((CANCELS_FROM - mean / both) / (CANCELS_FROM - CANCELS_UP_TO), 0.0, 1.0)
        return np.asarray(most * most * (3.0 - 2.0 * most))

    def _smooth(self, which: int, newest: float, power: FloatArray) -> FloatArray:
        smoothed, self._powers[which] = scipy.signal.lfilter(
            [newest], [1.0, newest - 1.0], power, zi=self._powers[which]
        )
        return np.asarray(smoothed)


def _routes(weights: FloatArray) -> list[tuple[int, float]]:
    return [(int(channel), float(weights[channel])) for channel in np.flatnonzero(weights)]


def _sum(rows: FloatArray, routes: list[tuple[int, float]]) -> FloatArray:
    # One by one: an order that depended on the block's shape would change the sum with the split.
    (first, weight), *others = routes
    total: FloatArray = rows[first] * weight
    for channel, weight in others:
        total += rows[channel] * weight
    return total
