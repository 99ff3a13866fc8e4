"""Partial tracks: time, frequency, amplitude and phase at points of a partial (sine component)."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from audioflinger_hook.exports.envelope import simplify
from audioflinger_hook.exports.glides import (
    FRAME,
    FRAMES,
    SLOT,
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
both parts is inexact until the filters settle.
"""

# The low-pass rings after a track. The ringing counts as part of the track until it falls below
# `FAINT` of the track's largest amplitude, but for at most `RING_S`.
RING_S, FAINT = 0.06, 0.003

# Largest errors of linear interpolation: of the amplitude, relative to the track's largest, and of
# the frequency in Hz. At lower amplitudes, a larger frequency error is allowed.
LEVEL_TOLERANCE, HZ_TOLERANCE = 0.01, 0.3
POINT_S, LONGEST_S = 0.002, 0.1  # smallest and largest time between two points


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
        # Linear frequency does not reproduce the phase exactly; the difference is spread over the
        # interval.
        missed = np.diff(self.turns)[place] - length * (self.hz[place] + 0.5 * slope * length)
        turns: FloatArray = self.turns[place] + since * (
            self.hz[place] + 0.5 * slope * since + missed / length
        )
        return turns

    def on_device(self, band_hz: Band | None) -> "PartialTrack":
        """Return the track with its frequencies mapped to a device's band; see `to_device_hz`."""
        if band_hz is None:
            return self
        hz = to_device_hz(self.hz, band_hz)
        turned = np.cumsum(np.diff(self.time_s) * (hz[1:] + hz[:-1]) / 2)
        turns = self.turns[0] + np.concatenate(([0.0], turned))
        return replace(self, hz=hz, turns=turns)


class TrackReader:
    """Makes tracks from a channel's successive glides, on one thread. gain: amplitude factor."""

    def __init__(self, design: LiveDesign, gain: float) -> None:
        self._design = design
        self._gain = gain
        self._open: dict[int, list[tuple[list[float], bool]]] = {}
        self._count = 0

    def add(self, rows: FloatArray, frame: int) -> Iterator[PartialTrack]:
        """Add glides, at least all that start before `frame`; yield the tracks that have ended."""
        rows = rows[np.lexsort((rows[:, SLOT], rows[:, FRAME]))]
        rises = rising(self._design, rows)
        for row, rise in zip(rows.tolist(), rises.tolist(), strict=True):
            slot = int(row[SLOT])
            mine = self._open.get(slot)
            if mine:
                last = mine[-1][0]
                joined = last[FRAME] + last[FRAMES] == row[FRAME] and row[START_LEVEL] > 0.0
                lasts_s = (row[FRAME] - mine[0][0][FRAME]) / self._design.samplerate
                if not joined or lasts_s >= LONGEST_TRACK_S:
                    yield from self._end(slot)
            self._open.setdefault(slot, []).append((row, rise))
        for slot, mine in list(self._open.items()):
            last = mine[-1][0]
            if last[FRAME] + last[FRAMES] + self._design.grid.hop_frames < frame:
                yield from self._end(slot)

    def rest(self) -> Iterator[PartialTrack]:
        """Yield the tracks that have not ended."""
        for slot in list(self._open):
            yield from self._end(slot)

    def _end(self, slot: int) -> Iterator[PartialTrack]:
        """Yield the track of a slot, filtered by the low-pass; yield nothing if it is silent."""
        mine, design = self._open.pop(slot), self._design
        rows = np.array([row for row, _ in mine])
        glides, glide_hz = analytic(design, rows, np.array([rise for _, rise in mine]))
        low_rate_hz = design.samplerate / design.grid.decimation
        ring = np.zeros(round(RING_S * low_rate_hz), np.complex128)
        signal, _ = low_pass(design, np.concatenate((glides.ravel(), ring)), at_rest(design))
        amplitude = self._gain * np.abs(signal)
        loudest = float(amplitude.max())
        audible = np.flatnonzero(amplitude > FAINT * loudest)
        if not loudest or audible[-1] - audible[0] < 2:
            return
        part = slice(int(audible[0]), int(audible[-1]) + 1)
        turns = np.unwrap(np.angle(signal[part])) / (2.0 * np.pi)
        known_hz = np.concatenate((glide_hz.ravel(), np.full(ring.size, glide_hz[-1, -1])))[part]
        # While the low-pass starts and rings, the phase can change at any rate, so clip the rate.
        hz = np.clip(np.gradient(turns) * low_rate_hz, 0.8 * known_hz, 1.25 * known_hz)
        start_s = aligned_s(design, rows[0, FRAME])
        times = start_s + np.arange(part.start, part.stop) / low_rate_hz
        amplitude = amplitude[part]
        tolerance = np.column_stack(
            (np.full(hz.size, LEVEL_TOLERANCE * loudest),
             HZ_TOLERANCE * np.sqrt(loudest / amplitude))
        )  # fmt: skip
        spacing, longest = max(1, round(POINT_S * low_rate_hz)), round(LONGEST_S * low_rate_hz)
        kept = simplify(times, np.column_stack((amplitude, hz)), tolerance, spacing, longest)
        onset = slot >= first_onset_slot(design)
        columns = (values[kept] for values in (times, hz, amplitude, turns))
        yield PartialTrack(self._count, onset, *columns)
        self._count += 1
