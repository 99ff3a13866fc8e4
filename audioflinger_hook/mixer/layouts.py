"""Positions of channels in Android's layouts, and the mapping of one layout to another."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

MINUS_3_DB = 0.5**0.5

CHANNELS_MAX = 64
"""Largest channel count; Android stops at 32, sound files do not."""

# AOSP's canonical positions by channel count, in the order of their mask bits.
_FRONT = "FL FR FC LFE BL BR SL SR"
_CANONICAL = {
    1: "FC",
    2: "FL FR",
    3: "FL FR LFE",
    4: "FL FR BL BR",
    5: "FL FR FC BL BR",
    6: "FL FR FC LFE BL BR",
    7: "FL FR FC LFE BL BR BC",
    8: _FRONT,
    12: f"{_FRONT} TFL TFR TBL TBR",
    14: f"{_FRONT} TFL TFR TBL TBR FWL FWR",
    16: f"{_FRONT} TFL TFR TBL TBR TSL TSR FWL FWR",
    24: "FL FR FC LFE BL BR FLC FRC BC SL SR TC TFL TFC TFR TBL TBC TBR TSL TSR BFL BFC BFR LFE2",
}


@cache
def layout(channels: int) -> tuple[str, ...]:
    """The positions of 1 to 64 channels, from AOSP if AOSP has a layout for that count.

    Other counts (9 to 11, 13, 15, 17 to 23, from 25) have the positions of 7.1, then pairs `L9
    R10`, ... and, for an odd count, one `C`.
    """
    if channels in _CANONICAL:
        return tuple(_CANONICAL[channels].split())
    positions = _FRONT.split()
    while len(positions) + 2 <= channels:
        positions += [f"L{len(positions) + 1}", f"R{len(positions) + 2}"]
    return (*positions, f"C{channels}") if len(positions) < channels else tuple(positions)


@cache
def sides(channels: int) -> str:
    """One letter per channel: the volume that it follows, L, R, or C for the mean of both.

    As in AudioFlinger, except for the one channel of a mono mix: it is C here and L there, since a
    sound panned right must not vanish. With two LFE channels (22.2) the first is L, the second R.
    """
    positions = layout(channels)
    two_lfe = "LFE2" in positions
    return "".join(
        {"LFE": "L", "LFE2": "R"}[position] if two_lfe and "LFE" in position else _side(position)
        for position in positions
    )


def _side(position: str) -> str:
    name = position.rstrip("0123456789")
    if name in ("FLC", "FRC"):
        return name[1]
    return name[-1] if name[-1] in "LR" else "C"


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
    """How much each channel counts in each source of vibration: (channels, sources).

    sources: each "mix", "left", "right", "front" or "back". The mix is the mean of all channels.
    The other sources are means of the channels on that side and of the channels that belong to both
    sides, such as the centre; the latter are weighted 3 dB lower. The weights of a source add up to
    1. So no source exceeds full scale, and a sound that is equal in all channels has the same level
    in every source. If no channel is behind, "front" and "back" are the mix; if no channel is on a
    side, all sources are.
    """
    letters = {"left": sides, "right": sides, "front": depths, "back": depths}
    weights = np.ones((channels, len(sources)))
    for column, source in enumerate(sources):
        if source == "mix":
            continue
        places = letters[source](channels)
        own = source[0].upper()
        if set(places) >= set(_OPPOSITES[own]):
            weights[:, column] = [
                1.0 if place == own else MINUS_3_DB if place == "C" else 0.0 for place in places
            ]
    weights /= weights.sum(axis=0)
    return weights


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
        """Return the frames (n, track channels) in the mix's channels, in the memory of `mapped`.

        If nothing is to be done, the frames themselves are returned; mono stays (n, 1), to
        broadcast.
        mapped: (n, mix channels); spare: (n,), overwritten. Called by the mixer's thread.
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
