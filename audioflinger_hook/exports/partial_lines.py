"""Partial tracks as JSON lines, written as the sound plays: see partials.schema.json.

A header, one line for each track when it ends, and a last line. A file without the last line is
cut.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from audioflinger_hook.exports.parametric import Job, TrackWriter, json_bytes
from audioflinger_hook.exports.tracks import PartialTrack

VERSION = 1


class PartialLines(TrackWriter):
    """Writes each track when it ends."""

    def __init__(self, job: Job) -> None:
        super().__init__(job)
        self._points = 0
        self._line(
            type="header",
            format="haptic-cushion-partials",
            version=VERSION,
            samplerate_hz=job.design.samplerate,
            channels=job.channels,
            profile=job.settings.profile,
            device_band_hz=self._band_hz,
        )

    def take(self, channel: int, track: PartialTrack) -> None:
        """Write a track that has ended."""
        self._points += track.time_s.size
        columns = (
            np.round(track.time_s, 6),
            np.round(track.hz, 3),
            np.round(track.amplitude, 7),
            np.round(track.turns % 1.0, 4) % 1.0,
        )
        points = np.column_stack(columns).tolist()
        place = {"channel": channel, "track": track.number, "onset": track.onset}
        self._line(type="track", **place, points=points)

    def write_rest(self, duration_s: float) -> dict[str, int]:
        """Write the last line."""
        self._line(type="end", duration_s=duration_s, tracks=self._tracks)
        return {"points": self._points}

    def _line(self, **entry: Any) -> None:
        self._job.file.write(json_bytes(entry) + b"\n")
