"""Channel positions for each channel count, as on Android, and the down-mix to two channels."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

MINUS_3_DB = 0.5**0.5
CHANNELS_MAX = 64  # largest channel count; Android allows 32, sound files allow more

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

KNOWN = tuple(_CANONICAL)  # channel counts with known positions


@cache
def layout(channels: int) -> tuple[str, ...]:
    """Return the positions of 1 to 64 channels, from Android (AOSP) if it has a layout for them.

    Every other count has the positions of 7.1, followed by pairs `L9 R10`, `L11 R12` and so on. If
    the count is odd, the last channel is a centre channel, for example `C9`.
    """
    if channels in _CANONICAL:
        return tuple(_CANONICAL[channels].split())
    positions = _FRONT.split()
    while len(positions) + 2 <= channels:
        positions += [f"L{len(positions) + 1}", f"R{len(positions) + 2}"]
    return (*positions, f"C{channels}") if len(positions) < channels else tuple(positions)


def order_from_alsa(channels: int) -> tuple[int, ...] | None:
    """Return ALSA's channel number of each `layout` position for 5, 6 or 8 channels, else None."""
    if channels not in (5, 6, 8):
        return None
    theirs = ("FL", "FR", "BL", "BR", "FC", "LFE", "SL", "SR")
    return tuple(theirs.index(position) for position in layout(channels))


@cache
def sides(channels: int) -> str:
    """Return one letter per channel: L for left, R for right, C for centre.

    The volume of a channel C is the mean of the left and the right volume. The letters follow
    AudioFlinger, except that AudioFlinger treats a mono channel as L. A mono sound that is panned
    right would then be silent. With two LFE channels (22.2), the first is L and the second is R.
    """
    positions = layout(channels)
    known = {"FLC": "L", "FRC": "R"}
    if "LFE2" in positions:
        known |= {"LFE": "L", "LFE2": "R"}
    lasts = (position.rstrip("0123456789")[-1] for position in positions)
    return "".join(map(known.get, positions, (last if last in "LR" else "C" for last in lasts)))


@cache
def downmix(channels: int) -> NDArray[np.float64]:
    """Return each channel's weights in the left and the right output channel: (channels, 2).

    The weights of the 5.0 channels follow ITU-R BS.775-3, table 2. FL and FR have 0 dB in the
    output of their side, all other side channels -3 dB. FC and a single LFE channel have -3 dB in
    both outputs. All other centre channels, such as BC, have -6 dB in both outputs. The outputs may
    clip: the weights are not normalised, so that a stereo sound has the same level in every layout.
    For one channel, or a count without known positions, both outputs are the mean of all channels.
    """
    if channels == 1 or channels not in KNOWN:
        return np.full((channels, 2), 1.0 / channels)
    halves = np.zeros((channels, 2))
    for row, position, side in zip(halves, layout(channels), sides(channels), strict=True):
        is_half = side == "C" and position not in ("FC", "LFE")
        weight = 1.0 if position in ("FL", "FR") else 0.5 if is_half else MINUS_3_DB
        row[:] = weight * (side != "R"), weight * (side != "L")
    return halves
