"""Where channels stand, by Android's layouts, and tracks laid over another layout."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

MINUS_3_DB = 0.5**0.5

CHANNELS_MAX = 64
"""Android stops at 32; sound files do not."""

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
    """The positions of 1 to 64 channels: those of AOSP where it knows that count.

    For the others (9 to 11, 13, 15, 17 to 23, from 25) 7.1 is followed by pairs `L9 R10`, ...
    and, for an odd count, one `C`.
    """
    if channels in _CANONICAL:
        return tuple(_CANONICAL[channels].split())
    positions = _FRONT.split()
    while len(positions) + 2 <= channels:
        positions += [f"L{len(positions) + 1}", f"R{len(positions) + 2}"]
    return (*positions, f"C{channels}") if len(positions) < channels else tuple(positions)


@cache
def sides(channels: int) -> str:
    """One letter a channel: on whose volume it hangs, L, R, or C for the mean of both.

    As in AudioFlinger, except that the one channel of a mono mix is C there L: a sound panned
    right must not vanish. With two LFE channels (22.2) the first is L, the second R.
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
    """One letter a channel: F in front, B behind, C for both: the sides, above, and the bass."""
    return "".join(
        "B" if name in _BACK else "F" if name.startswith(_FRONT_PREFIXES) else "C"
        for name in layout(channels)
    )


def source_weights(channels: int, sources: Sequence[str]) -> NDArray[np.float64]:
    """How much each channel counts in each source of vibration: (channels, sources).

    sources: of "mix", "left", "right", "front", "back". The mix is the mean of all channels. The
    others are means too, of the channels on that side, with those that belong to both sides, such
    as the centre, at -3 dB of the others. The weights of a source add up to 1: none exceeds full
    scale, and what is the same in all channels has the same level in every source. "front" and
    "back" are the mix where no channel is behind, as all are where no channel is on a side.
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
