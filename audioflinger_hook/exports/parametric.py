"""Writing of parametric formats, which contain envelopes or partials instead of samples."""

import json
import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.exports.decimals import decimal_text, point_texts
from audioflinger_hook.exports.glides import CHANNEL, COLUMNS, FRAMES, CurveReader, VibrationCurve
from audioflinger_hook.exports.options import FORMATS, Band, ExportOptions
from audioflinger_hook.exports.tracks import EndedTrack, PartialTrack, TrackReader, audible_tracks
from audioflinger_hook.pipeline.framework import Framework
from audioflinger_hook.pipeline.step import Step
from audioflinger_hook.transform.design import LiveDesign
from device.atomic_file import AtomicFile
from device.errors import UsageError
from device.units import Float32Array, FloatArray, db_to_amplitude

DURATION_MAX_S = 3600.0  # longest sound of formats whose file is composed in memory
SHORTEST_S = 0.001
TOGETHER_S = 40.0  # duration of all tracks that are computed together
JOBS_MAX = 16  # most calls of `TrackWriter.add` that wait for the thread


@dataclass(frozen=True)
class Composed:
    """Measured errors and counts of a file, keyed by name, and warnings."""

    error: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


Content = tuple[bytes, Composed]
Compose = Callable[[VibrationCurve, float, Band | None], Content]
"""Composes a file's content from the curve, the duration in seconds and the device's band."""


@dataclass(frozen=True)
class Job:
    """Input of a writer. channels: number of channels of vibration. gain: amplitude factor."""

    file: AtomicFile
    settings: Settings
    options: ExportOptions
    design: LiveDesign
    channels: int
    gain: float


class DescribedOutput:
    """Writes a file from the glides (see `glides`) of partials. Only one thread may use it.

    composed: measured errors, counts and warnings, known after `close`.
    UsageError, WriteError: as for `AtomicFile`.
    """

    def __init__(
        self,
        path: Path,
        samplerate: int,
        channels: int,
        settings: Settings,
        options: ExportOptions,
        open_writer: "Callable[[Job], Writer]",
    ) -> None:
        self.samplerate, self.channels = samplerate, channels
        self.composed = Composed()
        self._format = options.format
        self._file = AtomicFile(path)
        design = LiveDesign.of(settings.parameters, samplerate)
        gain = db_to_amplitude(settings.gain_db)
        self._writer = open_writer(Job(self._file, settings, options, design, channels, gain))
        self._heard = self._played = 0  # frames of sound, and frames of vibration

    def observe(self, framework: Framework) -> Callable[[Step], None]:
        """Start recording glides. Return a function that takes each step of the pipeline."""
        framework.take_glides()

        def take(step: Step) -> None:
            self._heard += len(step.audio)
            self._played += len(step.vibration)
            if FORMATS[self._format].whole:
                check_duration(self._heard / self.samplerate, self._format)
            rows = framework.take_glides()
            for channel in range(self.channels):
                self._writer.add(channel, rows[rows[:, CHANNEL] == channel], self._played)

        return take

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Do nothing: the glides describe the whole vibration."""

    def close(self) -> None:
        """Write the rest of the file, which then appears under its name."""
        self.composed = self._writer.finish(self._heard / self.samplerate)
        self._writer.end()
        self._file.commit()

    def abort(self) -> None:
        """Discard the file."""
        self._writer.end()
        self._file.abort()


class CurveWriter:
    """Writes a format that contains the envelope of one channel. Only one thread may use it."""

    def __init__(self, job: Job, compose: Compose) -> None:
        self._job, self._compose = job, compose
        self._reader = CurveReader(job.design, job.gain)

    def add(self, channel: int, rows: FloatArray, frame: int) -> None:
        """Add glides. The calls so far must include all glides that start before `frame`."""
        self._reader.add(rows, frame)

    def finish(self, duration_s: float) -> Composed:
        """Write the file."""
        curve, band_hz = self._reader.curve(duration_s), self._job.options.device_band_hz
        content, composed = self._compose(curve, duration_s, band_hz)
        self._job.file.write(content)
        return composed

    def end(self) -> None:
        """Do nothing: there is no thread."""


class TrackWriter(ABC):
    """Writes a format that contains the partial tracks of all channels. One thread may use it.

    While the caller renders the next sound, a thread of the writer computes the tracks.
    """

    def __init__(self, job: Job) -> None:
        self._job = job
        self._band_hz = job.options.device_band_hz
        self._readers = [TrackReader(job.design, channel) for channel in range(job.channels)]
        self._counts = [0] * job.channels
        self._ended: list[EndedTrack] = []
        self._waiting_s = 0.0  # duration of all tracks in `_ended`
        self._worker = ThreadPoolExecutor(1)
        self._jobs: deque[Future[None]] = deque()

    def add(self, channel: int, rows: FloatArray, frame: float) -> None:
        """Add glides of a channel. The calls so far must include all that start before `frame`."""
        self._jobs.append(self._worker.submit(self._divide, channel, rows, frame))
        if len(self._jobs) > JOBS_MAX:
            self._jobs.popleft().result()

    def finish(self, duration_s: float) -> Composed:
        """Take the tracks that have not ended, write the rest of the file and return counts."""
        for channel in range(self._job.channels):
            self.add(channel, np.zeros((0, COLUMNS)), math.inf)
        while self._jobs:
            self._jobs.popleft().result()
        self._take_all()
        counts = {"tracks": sum(self._counts), **self.write_rest(duration_s)}
        return Composed({name: float(count) for name, count in counts.items()})

    def end(self) -> None:
        """End the thread, which then writes no more."""
        self._worker.shutdown(cancel_futures=True)

    def _divide(self, channel: int, rows: FloatArray, frame: float) -> None:
        for track in self._readers[channel].add(rows, frame):
            self._ended.append(track)
            self._waiting_s += float(track.rows[:, FRAMES].sum()) / self._job.design.samplerate
            if self._waiting_s > TOGETHER_S:
                self._take_all()

    def _take_all(self) -> None:
        ended, self._ended, self._waiting_s = self._ended, [], 0.0
        if tracks := audible_tracks(self._job.design, self._job.gain, ended, self._counts):
            self.take([(channel, track.on_device(self._band_hz)) for channel, track in tracks])

    @abstractmethod
    def take(self, tracks: list[tuple[int, PartialTrack]]) -> None:
        """Write or store tracks, each with its channel. Frequencies are those of the device."""

    @abstractmethod
    def write_rest(self, duration_s: float) -> dict[str, int]:
        """Write the rest of the file, and return counts for the report."""


class PartialLines(TrackWriter):
    """Writes partial tracks as JSON lines, described by partials.schema.json.

    The first line is a header. When a track ends, its line is written. The last line marks the
    end. A file without the last line is incomplete.
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

    def take(self, tracks: list[tuple[int, PartialTrack]]) -> None:
        """Write tracks that have ended."""
        sizes = np.array([track.time_s.size for _, track in tracks])
        self._points += int(sizes.sum())
        time_s, hz, amplitude, turns = (
            np.concatenate([getattr(track, name) for _, track in tracks])
            for name in ("time_s", "hz", "amplitude", "turns")
        )
        phase = np.round(turns % 1.0, 4) % 1.0
        places = ((time_s, 6), (hz, 3), (amplitude, 7), (phase, 4))
        texts = point_texts([decimal_text(*column) for column in places], sizes)
        for (channel, track), points in zip(tracks, texts, strict=True):
            onset = json.dumps(track.onset)
            head = f'{{"type":"track","channel":{channel},"track":{track.number},"onset":{onset}'
            self._job.file.write(head.encode() + b',"points":[%b]}\n' % points)

    def write_rest(self, duration_s: float) -> dict[str, int]:
        """Write the end line."""
        self._line(type="end", duration_s=duration_s, tracks=sum(self._counts))
        return {"points": self._points}

    def _line(self, **entry: Any) -> None:
        self._job.file.write(json_bytes(entry) + b"\n")


Writer: TypeAlias = CurveWriter | TrackWriter


def json_bytes(document: dict[str, Any]) -> bytes:
    """Return a document as JSON without spaces."""
    return json.dumps(document, separators=(",", ":")).encode()


def rounded(value: float) -> float:
    """Return a value rounded to 5 decimals, with 0.0 for -0.0."""
    return round(float(value), 5) + 0.0


def check_duration(duration_s: float, name: str) -> None:
    """Raise UsageError if a sound is too long for a format whose file is made in memory."""
    if duration_s > DURATION_MAX_S:
        streamed = ", ".join(name for name, one in FORMATS.items() if not one.whole)
        raise UsageError(
            f"the sound is too long for the format {name}, which a player reads as a whole; "
            f"allowed: {DURATION_MAX_S:g} s; cut it, or choose one of: {streamed}"
        )


def refuse_settings(name: str, settings: Settings) -> None:
    """Raise UsageError for settings that parametric formats cannot represent."""
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
