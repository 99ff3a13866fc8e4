"""Partial tracks as JSON lines, written as the sound plays: see partials.schema.json.

A header, one line for each track when it ends, and a last line. A file without the last line is
cut.
"""

from __future__ import annotations

import json

import numpy as np

from audioflinger_hook.exports.parametric import Composed, Job
from audioflinger_hook.exports.tracks import PartialTrack, TrackReader
from device.atomic_file import AtomicFile
from device.units import FloatArray

VERSION = 1


class PartialLines:
    """Writes the tracks of all channels. Use from one thread."""

    def __init__(self, job: Job) -> None:
        self._band_hz = job.options.device_band_hz
        self._readers = [TrackReader(job.design, job.gain) for _ in range(job.channels)]
        self._file = AtomicFile(job.target)
        self._tracks = self._points = 0
        low_hz, high_hz = self._band_hz or (None, None)
        self._line(
            {
                "type": "header",
                "format": "haptic-cushion-partials",
                "version": VERSION,
                "samplerate_hz": job.design.samplerate,
                "channels": job.channels,
                "profile": job.settings.profile,
                "device_band_hz": [low_hz, high_hz] if self._band_hz else None,
            }
        )

    def add(self, voice: int, rows: FloatArray, frame: int) -> None:
        """Take glides and write the tracks that have ended."""
        for track in self._readers[voice].add(rows, frame):
            self._write(voice, track)

    def finish(self, duration_s: float) -> Composed:
        """Write the rest and give the file its name."""
        for voice, reader in enumerate(self._readers):
            for track in reader.rest():
                self._write(voice, track)
        self._line({"type": "end", "duration_s": duration_s, "tracks": self._tracks})
        self._file.commit()
        return Composed({"tracks": float(self._tracks), "points": float(self._points)})

    def abort(self) -> None:
        """Discard the file."""
        self._file.abort()

    def _write(self, voice: int, track: PartialTrack) -> None:
        track = track.on_device(self._band_hz)
        self._tracks += 1
        self._points += track.time_s.size
        columns = (
            np.round(track.time_s, 6),
            np.round(track.hz, 3),
            np.round(track.amplitude, 7),
            np.round(track.turns % 1.0, 4) % 1.0,
        )
        self._line(
            {
                "type": "track",
                "channel": voice,
                "track": track.number,
                "onset": track.onset,
                "points": np.column_stack(columns).tolist(),
            }
        )

    def _line(self, entry: dict[str, object]) -> None:
        self._file.write(json.dumps(entry, separators=(",", ":")).encode() + b"\n")
