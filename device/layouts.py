"""Positions of channels by their number, as on Android, and the down-mix of each layout to two."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

MINUS_3_DB = 0.5**0.5

CHANNELS_MAX = 64  # largest channel count; Android stops at 32, sound files do not

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

KNOWN = tuple(_CANONICAL)
"""Channel counts whose positions are known; other counts may be any sounds side by side."""


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


def order_from_alsa(channels: int) -> tuple[int, ...] | None:
    """The numbers of ALSA's channels in the order of `layout`; None if they need no other order.

    ALSA has the surrounds before the centre in 5.0, 5.1 and 7.1.
    """
    if channels not in (5, 6, 8):
        return None
    theirs = ("FL", "FR", "BL", "BR", "FC", "LFE", "SL", "SR")
    return tuple(theirs.index(position) for position in layout(channels))


@cache
def sides(channels: int) -> str:
    """One letter per channel: the volume that it follows, L, R, or C for the mean of both.

    As in AudioFlinger, except for a mono mix: its channel is C here and L there, since a sound
    panned right must not vanish. With two LFE channels (22.2) the first is L, the second R.
    """
    positions = layout(channels)
    known = {"FLC": "L", "FRC": "R"}
    if "LFE2" in positions:
        known |= {"LFE": "L", "LFE2": "R"}
    letters = []
    for position in positions:
        last = position.rstrip("0123456789")[-1]
        letters.append(known.get(position, last if last in "LR" else "C"))
    return "".join(letters)


@cache
def downmix(channels: int) -> NDArray[np.float64]:
    """How much each channel counts in the two halves, left and right, of the mix: (channels, 2).

    The mix is the mean of both halves. After ITU-R BS.775-3, table 2: the front pair counts fully
    on its side. Every other channel of a side counts 3 dB less; so do the centre and the bass
    channel, on both sides. A centre that is behind or above counts 6 dB less on both.
    Nothing is scaled to fit full scale: the same stereo has the same level in every layout.
    Of a count whose positions are not known, the mix and both halves are the mean of all channels.
    """
    if channels == 1 or channels not in KNOWN:
        return np.full((channels, 2), 1.0 / channels)
    halves = np.zeros((channels, 2))
    for row, position, side in zip(halves, layout(channels), sides(channels), strict=True):
        if position in ("FL", "FR"):
            weight = 1.0
        elif side == "C" and position not in ("FC", "LFE"):
            weight = 0.5
        else:
            weight = MINUS_3_DB
        row[:] = weight * (side != "R"), weight * (side != "L")
    return halves
