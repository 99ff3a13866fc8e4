"""Partial tracks: time, frequency, amplitude and phase at points of a partial (sine component)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.exports.envelope import simplify
from audioflinger_hook.exports.glides import (
    COLUMNS,
    END_HZ,
    END_LEVEL,
    FRAME,
    FRAMES,
    SLOT,
    START_HZ,
    START_LEVEL,
    aligned_s,
    analytic,
    at_rest,
    first_onset_slot,
    low_pass,
    rising,
)
from audioflinger_hook.exports.options import Band, to_device_hz
from audioflinger_hook.transform.design import LiveDesign
from device.units import FloatArray

LONGEST_TRACK_S = 10.0
"""A longer track is split, so that memory does not depend on its length. At a split, the sum of
both parts is inexact until the filters settle."""

# The low-pass rings after a track. The ringing counts as part of the track until it falls below
# `FAINT` of the track's largest amplitude, but for at most `RING_S`.
RING_S, FAINT = 0.06, 0.003

# Largest errors of linear interpolation: of the amplitude, relative to the track's largest, and of
# the frequency in Hz. At lower amplitudes, a larger frequency error is allowed.
LEVEL_TOLERANCE, HZ_TOLERANCE = 0.01, 0.3
POINT_S, LONGEST_S = 0.002, 0.1  # smallest and largest time between two points
TRACK_RATE_HZ = 1_000.0  # rate at which a track is sampled to choose its points
PADDED = 1.25  # largest ratio of lengths of tracks that are computed together


@dataclass(frozen=True)
class PartialTrack:
    """A partial, described by n points. Amplitude and frequency are linear between points.

    number: counted from 0 in its channel. onset: whether the partial started at an onset.
    time_s: (n,) time in the sound in s, less the latency. hz: (n,) frequency of the vibration.
    amplitude: (n,) full scale is 1. turns: (n,) phase of a cosine in cycles, unwrapped.
    """

    number: int
    onset: bool
    time_s: FloatArray
    hz: FloatArray
    amplitude: FloatArray
    turns: FloatArray

    def turns_at(self, time_s: FloatArray) -> FloatArray:
        """Return the phase in cycles. time_s: times within the track."""
        place = np.clip(np.searchsorted(self.time_s, time_s, "right") - 1, 0, self.hz.size - 2)
        length = np.diff(self.time_s)[place]
        since = time_s - self.time_s[place]
        slope = np.diff(self.hz)[place] / length
        # Linear frequency does not give the exact phase: spread the difference over the interval.
        missed = np.diff(self.turns)[place] - length * (self.hz[place] + 0.5 * slope * length)
        mean_hz = self.hz[place] + 0.5 * slope * since + missed / length
        return np.asarray(self.turns[place] + since * mean_hz)

    def on_device(self, band_hz: Band | None) -> "PartialTrack":
        """Return the track with its frequencies mapped to a device's band; see `to_device_hz`."""
        if band_hz is None:
            return self
        hz = to_device_hz(self.hz, band_hz)
        turned = np.cumsum(np.diff(self.time_s) * (hz[1:] + hz[:-1]) / 2)
        return replace(self, hz=hz, turns=self.turns[0] + np.concatenate(([0.0], turned)))


@dataclass(frozen=True)
class EndedTrack:
    """Glides of a partial: (n, columns), n >= 1, and whether the hop of each glide rises, (n,)."""

    channel: int
    rows: FloatArray
    rises: NDArray[np.bool_]


class TrackReader:
    """Divides a channel's successive glides into tracks, on one thread."""

    def __init__(self, design: LiveDesign, channel: int) -> None:
        self._design, self._channel = design, channel
        self._open = EndedTrack(channel, np.zeros((0, COLUMNS)), np.zeros(0, np.bool_))

    def add(self, rows: FloatArray, frame: float) -> list[EndedTrack]:
        """Add glides, at least all that start before `frame`; return the tracks that have ended.

        frame: infinity ends all tracks.
        """
        rows = rows[np.lexsort((rows[:, SLOT], rows[:, FRAME]))]
        rises = np.concatenate((self._open.rises, rising(self._design, rows)))
        rows = np.concatenate((self._open.rows, rows))
        order = np.lexsort((rows[:, FRAME], rows[:, SLOT]))
        rows, rises = rows[order], rises[order]
        starts, slots = rows[:, FRAME], rows[:, SLOT]
        same_slot = slots[1:] == slots[:-1]
        joined = (starts[:-1] + rows[:-1, FRAMES] == starts[1:]) & (rows[1:, START_LEVEL] > 0.0)
        cuts = [*(np.flatnonzero(~(same_slot & joined)) + 1).tolist(), len(rows)]
        first, ended, kept = 0, list[tuple[bool, float, float, int, int]](), list[int]()
        for cut in cuts if len(rows) else ():
            while first < cut:
                after_s = starts[first] + LONGEST_TRACK_S * self._design.samplerate
                end = first + int(np.searchsorted(starts[first:cut], after_s))
                if end < len(rows) and slots[end] == slots[first]:
                    ended.append((False, starts[end], slots[end], first, end))
                elif starts[end - 1] + rows[end - 1, FRAMES] + self._design.grid.hop_frames < frame:
                    ended.append((True, starts[first], slots[first], first, end))
                else:
                    kept += range(first, end)
                first = end
        self._open = EndedTrack(self._channel, rows[kept], rises[kept])
        # The order is that of the glides which end tracks, then that of the tracks' first glides.
        return [
            EndedTrack(self._channel, rows[first:end].copy(), rises[first:end].copy())
            for *_, first, end in sorted(ended)
        ]


def audible_tracks(
    design: LiveDesign, gain: float, ended: Sequence[EndedTrack], counts: list[int]
) -> list[tuple[int, PartialTrack]]:
    """Return the channel and the partial of each track that is not silent, in the same order.

    gain: amplitude factor. counts: number of audible tracks so far in each channel; is increased.
    """
    # Tracks of similar length are computed together, padded to the longest.
    kinds = [(one.rows[0, FRAMES], int(math.log(len(one.rows), PADDED))) for one in ended]
    found: dict[int, PartialTrack] = {}
    for _, group in groupby(sorted(range(len(ended)), key=kinds.__getitem__), kinds.__getitem__):
        found |= _filtered(design, gain, ended, list(group))
    tracks = []
    for place, track in sorted(found.items()):
        channel = ended[place].channel
        tracks.append((channel, replace(track, number=counts[channel])))
        counts[channel] += 1
    return tracks


def _filtered(
    design: LiveDesign, gain: float, ended: Sequence[EndedTrack], group: list[int]
) -> dict[int, PartialTrack]:
    """Return the tracks of a group, filtered by the low-pass, by place; leave out silent ones."""
    chosen = [ended[place] for place in group]
    lengths = np.array([len(one.rows) for one in chosen])
    # Repeat the last glide of each track at level 0.
    glide = np.minimum(np.arange(lengths.max()), lengths[:, None] - 1)
    glide += (np.cumsum(lengths) - lengths)[:, None]
    rows = np.concatenate([one.rows for one in chosen])[glide]
    padded = np.arange(lengths.max()) >= lengths[:, None]
    rows[padded, START_HZ] = rows[padded, END_HZ]
    rows[padded, START_LEVEL] = rows[padded, END_LEVEL] = 0.0
    rises = np.concatenate([one.rises for one in chosen])[glide]
    glides, glide_hz = analytic(design, rows.reshape(-1, rows.shape[2]), rises.ravel())
    low_rate_hz = design.samplerate / design.grid.decimation
    ring, size = round(RING_S * low_rate_hz), len(chosen)
    signal = np.pad(glides.reshape(size, -1), ((0, 0), (0, ring)))
    known_hz = np.pad(glide_hz.reshape(size, -1), ((0, 0), (0, ring)), "edge")
    rest = at_rest(design)
    state = np.zeros((*rest.shape[:-1], size, rest.shape[-1]), np.complex128)
    signal, _ = low_pass(design, signal, state)
    step = max(1, round(low_rate_hz / TRACK_RATE_HZ))
    signal, known_hz, rate_hz = signal[:, ::step], known_hz[:, ::step], low_rate_hz / step
    amplitude = gain * np.abs(signal)
    sample = np.arange(amplitude.shape[1])
    amplitude[sample * step >= (lengths * glides.shape[1] + ring)[:, None]] = 0.0
    loudest = amplitude.max(axis=1)
    audible = amplitude > FAINT * loudest[:, None]
    first, last = audible.argmax(axis=1), sample[-1] - audible[:, ::-1].argmax(axis=1)
    kept = np.flatnonzero((loudest > 0.0) & (last - first >= 2))
    if not kept.size:
        return {}
    # The audible parts of all tracks in a row.
    first, last, loudest = first[kept], last[kept], loudest[kept]
    part = (sample >= first[:, None]) & (sample <= last[:, None])
    sizes = last - first + 1
    ends = np.cumsum(sizes)
    begins = ends - sizes
    amplitude, known_hz = amplitude[kept][part], known_hz[kept][part]
    turns = np.angle(signal[kept][part]) / (2.0 * np.pi)
    wraps = np.concatenate(([0.0], np.cumsum(np.rint(np.diff(turns)))))
    turns -= wraps - np.repeat(wraps[begins], sizes)
    slope = np.empty_like(turns)
    slope[1:-1] = (turns[2:] - turns[:-2]) / 2.0
    slope[begins] = turns[begins + 1] - turns[begins]
    slope[ends - 1] = turns[ends - 1] - turns[ends - 2]
    # While the low-pass starts and rings, the phase can change at any rate, so clip the rate.
    hz = np.clip(slope * rate_hz, 0.8 * known_hz, 1.25 * known_hz)
    start_s = aligned_s(design, rows[kept, 0, FRAME])
    times = np.repeat(start_s, sizes) + np.broadcast_to(sample, part.shape)[part] / rate_hz
    peak = np.repeat(loudest, sizes)
    tolerance = np.column_stack((LEVEL_TOLERANCE * peak, HZ_TOLERANCE * np.sqrt(peak / amplitude)))
    spacing, longest = max(1, round(POINT_S * rate_hz)), round(LONGEST_S * rate_hz)
    values = np.column_stack((amplitude, hz))
    points = simplify(times, values, tolerance, spacing, longest, sizes.tolist())
    onset = rows[kept, 0, SLOT] >= first_onset_slot(design)
    columns = [one[points] for one in (times, hz, amplitude, turns)]
    cuts = np.searchsorted(points, begins[1:])
    parts = zip(*(np.split(column, cuts) for column in columns), strict=True)
    return {
        group[place]: PartialTrack(0, bool(is_onset), *columns)
        for place, is_onset, columns in zip(kept.tolist(), onset, parts, strict=True)
    }
