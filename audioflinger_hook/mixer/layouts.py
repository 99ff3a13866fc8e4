"""Channel weights of the sources of vibration, and gains between two channel layouts."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from device.layouts import MINUS_3_DB, downmix, layout, sides
from device.units import Float32Array

_BACK = ("BL", "BR", "BC", "TBL", "TBC", "TBR")
_FRONT_PREFIXES = ("F", "TF", "BF")
_HALVES = {"L": (2.0, 0.0), "R": (0.0, 2.0)}
_OPPOSITES = {"L": "LR", "R": "LR", "F": "FB", "B": "FB"}


@cache
def depths(channels: int) -> str:
    """Return one letter per channel: F for front, B for back, C for all others."""
    return "".join(
        "B" if name in _BACK else "F" if name.startswith(_FRONT_PREFIXES) else "C"
        for name in layout(channels)
    )


def source_weights(channels: int, sources: Sequence[str]) -> NDArray[np.float64]:
    """Return the weights of channels in both halves of each source, (channels, sources, 2).

    A source is the mono mix of its left and its right half; see `MonoMix`. sources: each "mix",
    "left", "right", "front" or "back". The source "mix" contains all channels; see `downmix`. Each
    other source is a weighted mean of the channels on its side and, at -3 dB, of central channels.
    If a layout has no channels on this side or on the opposite side, the source equals "mix".
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
            shares = {own: 1.0, "C": MINUS_3_DB}
            mean = np.array([shares.get(place, 0.0) for place in places])
            mean /= mean.sum()
            on_side = _HALVES if source in ("front", "back") else {}
            for row, side, share in zip(weights[:, column], sides(channels), mean, strict=True):
                row[:] = np.multiply(on_side.get(side, (1.0, 1.0)), share)
    return weights


class ChannelMap:
    """Mapping of the channels of one track to the channels of the mix.

    - If track and mix have the same number of channels, samples stay unchanged.
    - A mono track goes to every mix channel. A mono mix gets the mean of all track channels.
    - Otherwise a channel goes to the mix channel of the same position. Without such a position, a
      side channel goes to the front channel of its side at -3 dB. A centre channel goes to both
      front channels at -3 dB. If sums could exceed full scale, all gains are lowered equally.
    """

    def __init__(self, track_channels: int, mix_channels: int) -> None:
        matrix = mapping(track_channels, mix_channels)
        self.folds = track_channels > mix_channels
        self.spreads = track_channels < mix_channels
        # NumPy broadcasts a mono track to all mix channels without a copy.
        self._passes = track_channels in (1, mix_channels)
        self._routes = [(*place, matrix[tuple(place)]) for place in np.argwhere(matrix).tolist()]

    def apply(self, frames: Float32Array, out: Float32Array, spare: Float32Array) -> Float32Array:
        """Convert frames, (n, track channels), to the channels of the mix.

        If the track is mono or has as many channels as the mix, `frames` itself is returned.
        out: memory for the result, (n or more, mix channels). spare: working memory, (n or more,).
        """
        if self._passes:
            return frames
        out, spare = out[: len(frames)], spare[: len(frames)]
        out[...] = 0.0
        for source, target, gain in self._routes:
            # The order of additions is fixed, so the rounding does not depend on the block size.
            out[:, target] += np.multiply(frames[:, source], gain, out=spare)
        return out


@cache
def mapping(track_channels: int, mix_channels: int) -> Float32Array:
    """Return the gains from each track channel (row) to each mix channel (column)."""
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
