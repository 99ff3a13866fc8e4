"""Partials as tracks: points of time, frequency and amplitude, from birth to end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from audioflinger_hook.exports.glides import (
    END_HZ,
    END_LEVEL,
    FRAME,
    FRAMES,
    SLOT,
    START_HZ,
    START_LEVEL,
    START_PHASE,
    PlayedGlides,
)
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.design.synthesis import ATTACK_HOPS
from device.units import FloatArray

POINTS_MAX = 1_000
"""A longer track is continued in another one, so that memory does not depend on its length."""


@dataclass
class PartialTrack:
    """A partial: frequency and amplitude are linear between its points.

    Attributes
    ----------
    number : int
        Of the track, counted from 0; a continued track keeps it.
    onset : bool
        Whether an onset gave birth to it. It ends where the analysis takes over.
    phase : float
        In cycles at the first point, where a cosine has 0.
    points : list
        (time in seconds in the aligned vibration, Hz, amplitude in full scale).
    """

    number: int
    onset: bool
    phase: float
    points: list[tuple[float, float, float]] = field(default_factory=list)
    end_frame: int = 0


class TrackReader:
    """Joins the glides of one channel to tracks, block by block. Use from one thread.

    design: of the transform. gain: factor on all amplitudes.
    """

    def __init__(self, design: LiveDesign, gain: float) -> None:
        self._played = PlayedGlides(design)
        self._hop_frames = design.grid.hop_frames
        self._gain = gain
        self._still = design.synthesis.still
        self._first_fresh = 2 * (design.analysis.partials_max + design.onsets.fresh_max)
        self._open: dict[int, PartialTrack] = {}
        self._count = 0

    def add(self, rows: FloatArray, frame: int) -> Iterator[PartialTrack]:
        """Yield the tracks that end before this frame; all rows that begin before it are there."""
        order = np.lexsort((rows[:, SLOT], rows[:, FRAME]))
        rows = rows[order]
        fresh = rows[:, SLOT] >= self._first_fresh
        rise = np.where(fresh, 0.0, rows[:, END_LEVEL] - rows[:, START_LEVEL])
        _, hop = np.unique(rows[:, FRAME], return_inverse=True)
        rising = ~fresh & (np.bincount(hop, rise)[hop] > self._still) if len(rows) else fresh
        start_gain = self._gain * self._played.gain(rows[:, START_HZ])
        end_gain = self._gain * self._played.gain(rows[:, END_HZ])
        turns = self._played.turns(rows[:, START_HZ])
        for place, row in enumerate(rows.tolist()):
            slot = int(row[SLOT])
            track = self._open.get(slot)
            joined = track and track.end_frame == row[FRAME] and row[START_LEVEL] > 0.0
            if track and (not joined or len(track.points) >= POINTS_MAX):
                yield self._open.pop(slot)
            number = track.number if track and joined else self._count
            if not track or slot not in self._open:
                self._count += number == self._count
                phase = (row[START_PHASE] + turns[place]) % 1.0
                track = PartialTrack(number, bool(fresh[place]), phase)
                track.points.append(
                    (self._time_s(row[FRAME]), row[START_HZ], row[START_LEVEL] * start_gain[place])
                )
                self._open[slot] = track
            end = row[END_LEVEL] * end_gain[place]
            if rising[place]:
                # Amplitudes of a hop that rises are there after a part of it.
                share = ATTACK_HOPS
                hz = row[START_HZ] + share * (row[END_HZ] - row[START_HZ])
                track.points.append((self._time_s(row[FRAME] + share * row[FRAMES]), hz, end))
            track.end_frame = int(row[FRAME] + row[FRAMES])
            track.points.append((self._time_s(track.end_frame), row[END_HZ], end))
        for slot, track in list(self._open.items()):
            if track.end_frame + self._hop_frames < frame:
                yield self._open.pop(slot)

    def rest(self) -> Iterator[PartialTrack]:
        """Yield the tracks that last to the end."""
        yield from self._open.values()
        self._open = {}

    def _time_s(self, frame: float) -> float:
        return frame / self._played.samplerate + self._played.shift_s
