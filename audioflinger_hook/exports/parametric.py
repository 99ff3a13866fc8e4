"""Outputs and writers of formats that hold envelopes or partials instead of samples."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.exports.glides import CHANNEL, CurveReader, VibrationCurve
from audioflinger_hook.exports.options import FORMATS, Band, ExportOptions
from audioflinger_hook.exports.tracks import PartialTrack, TrackReader
from audioflinger_hook.pipeline.framework import Framework
from audioflinger_hook.pipeline.step import Step
from audioflinger_hook.transform.design import LiveDesign
from device.atomic_file import AtomicFile
from device.errors import UsageError
from device.units import Float32Array, FloatArray, db_to_amplitude

DURATION_MAX_S = 3 * 3600.0  # of formats whose file must be made as a whole
SHORTEST_S = 0.001


@dataclass(frozen=True)
class Composed:
    """Measured errors of a file, and warnings."""

    error: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


Compose = Callable[[VibrationCurve, float, Band | None], tuple[bytes, Composed]]
"""Makes a file's content from the curve, the duration in seconds and the device's band."""


@dataclass(frozen=True)
class Job:
    """What a writer needs. channels: of vibration. gain: factor on amplitudes."""

    file: AtomicFile
    settings: Settings
    options: ExportOptions
    design: LiveDesign
    channels: int
    gain: float


class DescribedOutput:
    """A `VibrationOutput` whose file is made from glides instead of samples. Use from one thread.

    composed: errors and warnings, once it is closed. UsageError, WriteError: as for `AtomicFile`.
    """

    def __init__(
        self,
        path: Path,
        samplerate: int,
        channels: int,
        settings: Settings,
        options: ExportOptions,
        open_writer: Callable[[Job], Writer],
    ) -> None:
        self.samplerate, self.channels = samplerate, channels
        self.composed = Composed()
        self._format = options.format
        self._file = AtomicFile(path)
        design = LiveDesign.of(settings.parameters, samplerate)
        gain = db_to_amplitude(settings.gain_db)
        self._writer = open_writer(Job(self._file, settings, options, design, channels, gain))
        self._heard = self._played = 0  # frames of sound and of vibration

    def observe(self, framework: Framework) -> Callable[[Step], None]:
        """Start to record glides; return the function that takes them after every step."""
        framework.take_glides()

        def take(step: Step) -> None:
            self._heard += len(step.audio)
            self._played += len(step.vibration)
            if FORMATS[self._format].whole:
                check_duration(self._played / self.samplerate, self._format)
            rows = framework.take_glides()
            for channel in range(self.channels):
                self._writer.add(channel, rows[rows[:, CHANNEL] == channel], self._played)

        return take

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Do nothing: the glides have all of the vibration."""

    def close(self) -> None:
        """Write the rest, and give the file its name."""
        self.composed = self._writer.finish(self._heard / self.samplerate)
        self._file.commit()

    def abort(self) -> None:
        """Discard the file."""
        self._file.abort()


class CurveWriter:
    """Writes a format that is made from the curve of one channel. Use from one thread."""

    def __init__(self, job: Job, compose: Compose) -> None:
        self._job, self._compose = job, compose
        self._reader = CurveReader(job.design, job.gain)

    def add(self, channel: int, rows: FloatArray, frame: int) -> None:
        """Take glides; all that begin before the frame are there."""
        self._reader.add(rows, frame)

    def finish(self, duration_s: float) -> Composed:
        """Write the file."""
        curve, band_hz = self._reader.curve(duration_s), self._job.options.device_band_hz
        content, composed = self._compose(curve, duration_s, band_hz)
        self._job.file.write(content)
        return composed


class TrackWriter(ABC):
    """Writes a format that is made from the partial tracks of all channels, on one thread."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._band_hz = job.options.device_band_hz
        self._readers = [TrackReader(job.design, job.gain) for _ in range(job.channels)]
        self._tracks = 0

    def add(self, channel: int, rows: FloatArray, frame: int) -> None:
        """Take a channel's glides; all that begin before the frame are there."""
        self._take_all(channel, self._readers[channel].add(rows, frame))

    def finish(self, duration_s: float) -> Composed:
        """Take the tracks that last to the end, and write the rest."""
        for channel, reader in enumerate(self._readers):
            self._take_all(channel, reader.rest())
        counts = {"tracks": self._tracks, **self.write_rest(duration_s)}
        return Composed({name: float(count) for name, count in counts.items()})

    def _take_all(self, channel: int, tracks: Iterable[PartialTrack]) -> None:
        for track in tracks:
            self._tracks += 1
            self.take(channel, track.on_device(self._band_hz))

    @abstractmethod
    def take(self, channel: int, track: PartialTrack) -> None:
        """Take a track with the device's frequencies."""

    @abstractmethod
    def write_rest(self, duration_s: float) -> dict[str, int]:
        """Write the rest of the file, and return counts for the report."""


class PartialLines(TrackWriter):
    """Writes partial tracks as JSON lines while the sound plays: see partials.schema.json.

    A header, one line for each track when it ends, and a last line, without which a file is cut.
    """

    def __init__(self, job: Job) -> None:
        super().__init__(job)
        self._points = 0
        self._line(
            type="header",
            format="haptic-cushion-partials",
            version=1,
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


Writer: TypeAlias = CurveWriter | TrackWriter


def json_bytes(document: dict[str, Any]) -> bytes:
    """Return a document as JSON without spaces."""
    return json.dumps(document, separators=(",", ":")).encode()


def rounded(value: float) -> float:
    """Return a value with 5 decimals, and 0 for -0."""
    return round(float(value), 5) + 0.0


def check_duration(duration_s: float, name: str) -> None:
    """Raise UsageError if a sound is too long for a format that is made as a whole."""
    if duration_s > DURATION_MAX_S:
        raise UsageError(
            f"the sound is longer than the format {name} may hold; allowed: "
            f"{DURATION_MAX_S / 3600:g} hours; cut it, or choose one of: partials, wav, flac"
        )


def refuse_settings(name: str, settings: Settings) -> None:
    """Raise UsageError for settings that a format without a waveform cannot hold."""
    if settings.form != "live":
        raise UsageError(
            f"transform = {settings.form!r} tracks no partials, from which the format {name} is "
            "made; allowed: live; use --transform live, or the format wav or flac"
        )
    shaping = ("damping", "protection", "exposure_cap")
    unheld = [key for key in shaping if getattr(settings, key) != "off"]
    unheld += ["actuator"] if settings.actuators else []
    if unheld:
        raise UsageError(
            f"the format {name} describes vibration for any actuator and cannot hold "
            f"{', '.join(unheld)}, which shape the waveform for one rig; allowed: off, and no "
            "[[actuator]]; change the config, or use the format wav or flac"
        )
