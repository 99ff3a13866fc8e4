"""What each source of vibration is made of, and the mapping of one layout to another."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from device.layouts import MINUS_3_DB, downmix, layout, sides
from device.units import Float32Array

_BACK = ("BL", "BR", "BC", "TBL", "TBC", "TBR")
_FRONT_PREFIXES = ("F", "TF", "BF")


@cache
def depths(channels: int) -> str:
    """One letter per channel: F in front, B behind, C for both (sides, above, bass)."""
    return "".join(
        "B" if name in _BACK else "F" if name.startswith(_FRONT_PREFIXES) else "C"
        for name in layout(channels)
    )


def source_weights(channels: int, sources: Sequence[str]) -> NDArray[np.float64]:
    """How much each channel counts in each source's halves: (channels, sources, 2).

    A source is the mean of its halves, left and right; see `MonoMix`. sources: each "mix", "left",
    "right", "front" or "back". The mix is that of `downmix`. The others are means of the channels
    on that side and of those that belong to both sides, such as the centre, which count 3 dB less.
    Their weights add up to 1: none exceeds full scale. "left" and "right" have equal halves. If no
    channel is behind, "front" and "back" are the mix; if none is on a side, all sources are.
    """
    letters = {"left": sides, "right": sides, "front": depths, "back": depths}
    weights = np.empty((channels, len(sources), 2))
    for column, source in enumerate(sources):
        weights[:, column] = downmix(channels)
        if source == "mix":
            continue
        places = letters[source](channels)
        own = source[0].upper()
        if set(places) >= set(_OPPOSITES[own]):
            mean = np.array(
                [1.0 if place == own else MINUS_3_DB if place == "C" else 0.0 for place in places]
            )
            mean /= mean.sum()
            on_side = _HALVES if source in ("front", "back") else {}
            for row, side, share in zip(weights[:, column], sides(channels), mean, strict=True):
                row[:] = np.multiply(on_side.get(side, (1.0, 1.0)), share)
    return weights


_HALVES = {"L": (2.0, 0.0), "R": (0.0, 2.0)}
_OPPOSITES = {"L": "LR", "R": "LR", "F": "FB", "B": "FB"}


class ChannelMap:
    """How the channels of one track are placed in the mix.

    With equal counts, channels stay unchanged. One track channel goes to every mix channel; one mix
    channel gets the mean of all track channels. Otherwise a channel goes to its own position. If
    the mix lacks that position, the channel goes to the front of its side at -3 dB, and a centre to
    both sides at -3 dB. Then all gains are lowered by one factor until no mix channel can exceed
    full scale. Mix channels that the track lacks are silent.
    """

    def __init__(self, track_channels: int, mix_channels: int) -> None:
        matrix = mapping(track_channels, mix_channels)
        self.folds = track_channels > mix_channels
        self.spreads = track_channels < mix_channels
        # a mono row is spread by NumPy's broadcasting, without a copy
        self._passes = track_channels in (1, mix_channels)
        self._routes = [
            (source, target, matrix[source, target])
            for source, target in np.argwhere(matrix).tolist()
        ]

    def apply(self, frames: Float32Array, out: Float32Array, spare: Float32Array) -> Float32Array:
        """Return the frames (n, track channels) in the mix's channels, in the memory of `out`.

        Frames that need no mapping are returned themselves; mono stays (n, 1), to broadcast.
        out: (n or more, mix channels); spare: (n or more,). Called by the mixer's thread.
        """
        if self._passes:
            return frames
        out, spare = out[: len(frames)], spare[: len(frames)]
        out[...] = 0.0
        for source, target, gain in self._routes:
            # one route after another: the same sum whatever the number of frames
            out[:, target] += np.multiply(frames[:, source], gain, out=spare)
        return out


@cache
def mapping(track_channels: int, mix_channels: int) -> Float32Array:
    """The gains from each track channel (row) to each mix channel (column), float32."""
    if track_channels == mix_channels:
        return np.eye(mix_channels, dtype=np.float32)
    if 1 in (track_channels, mix_channels):
        return np.full((track_channels, mix_channels), 1.0 / track_channels, np.float32)
    matrix = np.zeros((track_channels, mix_channels))
    there = {position: index for index, position in enumerate(layout(mix_channels))}
    for row, position in enumerate(layout(track_channels)):
        if position in there:
            matrix[row, there[position]] = 1.0
            continue
        side = sides(track_channels)[row]
        for front in ("FL", "FR"):
            if side in (front[1], "C"):
                matrix[row, there[front]] = MINUS_3_DB
    matrix /= max(1.0, matrix.sum(axis=0).max())
    return matrix.astype(np.float32)
