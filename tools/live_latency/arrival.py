"""When a recorded frame could first be had: a line of time through the arrivals of its blocks.

Blocks arrive early at best and late at will: a server hands them over in bursts, a busy machine
lets them wait. No block arrives before its last frame is there, so the earliest arrivals carry the
time, and all the others are ignored.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from audioflinger_hook.transform import FloatArray, IntArray

WINDOW_S = 0.5
"""Of the arrivals in so long only the earliest counts."""

NEIGHBOURS = 3
"""Windows on either side that are compared: late arrivals for a second make no jump."""

JUMP_S = 0.001
"""The line jumps by more than this where frames were lost, or came twice."""

WANDER = 200e-6
"""How fast the line may leave its mean slope, in seconds a second."""


class ArrivalLine:
    """The time at which each frame of one recording could first be had.

    times_s: (blocks,) when each block came, seconds of one clock, ascending; frames: (blocks,)
    how many frames there were with it. samplerate: nominal, Hz; the true one may lie anywhere
    near it and wander by 200 ppm. At least one block.

    jumps: frame numbers after which frames are missing or were inserted: the recording has a
    splice there. drift_ppm: how much slower than nominal frames come, in the mean. Any thread may
    use it, it never changes.
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
        """Return when each of these frames, numbers from 0 on, could first be had, in seconds."""
        nominal_s = np.asarray(frames, dtype=np.float64) / self._samplerate
        part = np.searchsorted(self._part_ends, nominal_s, side="left")
        times_s = nominal_s * (1.0 + self._slope)
        for index, (x, y) in enumerate(self._parts):
            mine = part == index
            times_s[mine] += np.interp(nominal_s[mine], x, y)
        return times_s


def _earliest(nominal_s: FloatArray, offset_s: FloatArray) -> IntArray:
    """Return the number of the earliest block in each window, in order."""
    window = np.floor((nominal_s - nominal_s[0]) / WINDOW_S).astype(np.intp)
    order = np.lexsort((offset_s, window))
    first = np.concatenate(([True], np.diff(window[order]) > 0))
    found: IntArray = order[first]
    return found


def _slope(x: FloatArray, y: FloatArray) -> float:
    """Return the usual slope between earliest arrivals 2 s apart: jumps are not usual."""
    apart = min(round(2.0 / WINDOW_S), len(x) - 1)
    if apart < 1:
        return 0.0
    return float(np.median((y[apart:] - y[:-apart]) / (x[apart:] - x[:-apart])))


def _breaks(earliest: IntArray, flat: FloatArray) -> list[int]:
    """Return the numbers of the last blocks before each jump; flat: offsets without the slope."""
    lows = flat[earliest]
    breaks: list[int] = []
    window = 1
    while window < len(lows):
        before = lows[max(0, window - NEIGHBOURS) : window].min()
        after = lows[window : window + NEIGHBOURS].min()
        ending = len(lows) - window < NEIGHBOURS  # lateness at the very end is no jump yet
        if abs(after - before) <= JUMP_S or (ending and after > before):
            window += 1
            continue
        first = breaks[-1] + 1 if breaks else 0
        first = max(first, int(earliest[max(0, window - NEIGHBOURS)]))
        beyond = min(window + NEIGHBOURS, len(lows) - 1)
        near = np.arange(first, int(earliest[beyond]) + 1)
        # Nothing comes earlier than its line. Up: what is too early for the later one precedes the
        # jump. Down: what is too early for the line so far follows it.
        too_early = near[flat[near] < max(before, after) - 0.5 * JUMP_S]
        last = int(too_early[-1]) if after > before else int(too_early[0]) - 1
        if 0 <= last < len(flat) - 1 and (not breaks or last > breaks[-1]):
            breaks.append(last)
        window = max(window + 1, int(np.searchsorted(earliest, last, side="right")) + NEIGHBOURS)
    return breaks


def _supported(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the highest line on or under all points that wanders no faster than WANDER."""
    line = y.copy()
    for i in range(1, len(line)):
        line[i] = min(line[i], line[i - 1] + WANDER * (x[i] - x[i - 1]))
    for i in range(len(line) - 2, -1, -1):
        line[i] = min(line[i], line[i + 1] + WANDER * (x[i + 1] - x[i]))
    return line
