"""Tracks laid over another layout of channels."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer.layouts import MINUS_3_DB, layout, sides


class ChannelMap:
    """How the channels of one track stand in the mix.

    Same count: untouched. One: into every channel. Into one: the mean of all. Otherwise a
    channel goes to its own position; one that the mix lacks goes to the front of its side at
    -3 dB, a centre to both sides at -3 dB; then everything is lowered by the same factor until
    no mix channel can exceed full scale. Mix channels that the track lacks are silent.
    """

    def __init__(self, track_channels: int, mix_channels: int) -> None:
        self.matrix = mapping(track_channels, mix_channels)
        self.is_identity = track_channels == mix_channels
        self.folds = track_channels > mix_channels
        self.spreads = track_channels < mix_channels
        # a mono row is spread by NumPy's broadcasting, without a copy
        self.broadcasts = track_channels == 1
        self._routes = [
            (int(source), int(target), self.matrix[source, target])
            for source, target in np.argwhere(self.matrix)
        ]

    def apply(
        self, frames: NDArray[np.float32], mapped: NDArray[np.float32], spare: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """The frames (n, track channels) in the mix's channels, in the memory of `mapped`.

        Where nothing is to be done the frames themselves; mono stays (n, 1), to be broadcast.
        mapped: (n, mix channels); spare: (n,) to be overwritten. Called by the mixer's thread.
        """
        if self.is_identity or self.broadcasts:
            return frames
        mapped[...] = 0.0
        for source, target, gain in self._routes:
            # one route after another: the same sum whatever the number of frames
            mapped[:, target] += np.multiply(frames[:, source], gain, out=spare)
        return mapped


@cache
def mapping(track_channels: int, mix_channels: int) -> NDArray[np.float32]:
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
