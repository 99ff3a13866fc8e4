"""Estimates when each frame of a recording could first have arrived.

Blocks of frames may arrive late, because a server sends several at once or the machine is busy. No
block arrives before its last frame exists. Therefore only the earliest arrivals are used.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from audioflinger_hook.transform import FloatArray, IntArray

WINDOW_S = 0.5  # length of a window in s; only its earliest arrival is used
NEIGHBOURS = 3  # number of windows compared on either side; fewer late windows are no jump
JUMP_S = 0.001  # smallest jump of the line, in s, that indicates lost or repeated frames
WANDER = 200e-6  # largest deviation of the line's slope from its median slope, in s per s


class ArrivalLine:
    """The earliest time at which each frame of a recording could have arrived.

    times_s: arrival time of each block in s, ascending, (blocks,); at least one.
    frames: number of frames up to the end of each block, (blocks,).
    samplerate: nominal rate in Hz; the true rate may differ, and may vary by 200 ppm.
    jumps: numbers of the frames where frames are missing or inserted.
    drift_ppm: median deviation of the frame rate in ppm; positive if this rate is below nominal.
    """

    def __init__(self, times_s: FloatArray, frames: IntArray, samplerate: float) -> None:
        self._samplerate = samplerate
        nominal_s = frames / samplerate
        offset_s = times_s - nominal_s
        earliest = _earliest(nominal_s, offset_s)
        x, y = nominal_s[earliest], offset_s[earliest]
        slope = _slope(x, y)
        self.drift_ppm = 1e6 * slope
        flat = offset_s - slope * nominal_s
        breaks = _breaks(earliest, flat)
        self.jumps: tuple[int, ...] = tuple(int(frames[last]) for last in breaks)
        edges = [-1, *breaks, len(frames) - 1]
        self._parts = []
        for before, last in pairwise(edges):
            own = np.arange(before + 1, last + 1)
            kept = own[_earliest(nominal_s[own], flat[own])]
            self._parts.append((nominal_s[kept], _supported(nominal_s[kept], flat[kept])))
        self._slope = slope
        self._part_ends = nominal_s[np.array(breaks, dtype=np.intp)]

    def times_s(self, frames: FloatArray | IntArray) -> FloatArray:
        """Return the earliest time in s at which each of these frames could have arrived."""
        nominal_s = np.asarray(frames, dtype=np.float64) / self._samplerate
        part = np.searchsorted(self._part_ends, nominal_s, side="left")
        times_s = nominal_s * (1.0 + self._slope)
        for index, (x, y) in enumerate(self._parts):
            mine = part == index
            times_s[mine] += np.interp(nominal_s[mine], x, y)
        return times_s


def _earliest(nominal_s: FloatArray, offset_s: FloatArray) -> IntArray:
    window = np.floor((nominal_s - nominal_s[0]) / WINDOW_S).astype(np.intp)
    order = np.lexsort((offset_s, window))
    first = np.concatenate(([True], np.diff(window[order]) > 0))
    found: IntArray = order[first]
    return found


def _slope(x: FloatArray, y: FloatArray) -> float:
    apart = min(round(2.0 / WINDOW_S), len(x) - 1)
    if apart < 1:
        return 0.0
    return float(np.median((y[apart:] - y[:-apart]) / (x[apart:] - x[:-apart])))


def _breaks(earliest: IntArray, flat: FloatArray) -> list[int]:
    """Return the index of the last block before each jump."""
    lows = flat[earliest]
    breaks: list[int] = []
    window = 1
    while window < len(lows):
        before = lows[max(0, window - NEIGHBOURS) : window].min()
        after = lows[window : window + NEIGHBOURS].min()
        ending = len(lows) - window < NEIGHBOURS  # lateness at the end is not a jump
        if abs(after - before) <= JUMP_S or (ending and after > before):
            window += 1
            continue
        first = breaks[-1] + 1 if breaks else 0
        first = max(first, int(earliest[max(0, window - NEIGHBOURS)]))
        beyond = min(window + NEIGHBOURS, len(lows) - 1)
        near = np.arange(first, int(earliest[beyond]) + 1)
        # No block can arrive earlier than its line. Before an upward jump, blocks arrive too early
        # for the later line. After a downward jump, they arrive too early for the earlier line.
        too_early = near[flat[near] < max(before, after) - 0.5 * JUMP_S]
        last = int(too_early[-1]) if after > before else int(too_early[0]) - 1
        if 0 <= last < len(flat) - 1 and (not breaks or last > breaks[-1]):
            breaks.append(last)
        window = max(window + 1, int(np.searchsorted(earliest, last, side="right")) + NEIGHBOURS)
    return breaks


def _supported(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the highest curve that is not above any point and has a slope of up to ±WANDER."""
    line = y.copy()
    for i in range(1, len(line)):
        line[i] = min(line[i], line[i - 1] + WANDER * (x[i] - x[i - 1]))
    for i in range(len(line) - 2, -1, -1):
        line[i] = min(line[i], line[i + 1] + WANDER * (x[i + 1] - x[i]))
    return line
