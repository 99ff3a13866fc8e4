"""Exports of envelopes and partials, from the glides of the live form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.exports.decimation import LeakMeter, Watch
from audioflinger_hook.exports.glides import VOICE, CurveReader, VibrationCurve
from audioflinger_hook.exports.options import (
    FORMATS,
    ExportOptions,
    ExportReport,
    check_channel_count,
)
from audioflinger_hook.pipeline.framework import OFFLINE_HAL_FRAMES, Framework
from audioflinger_hook.pipeline.step import Pipeline
from audioflinger_hook.sources import Client
from audioflinger_hook.transform.design import LiveDesign
from device.atomic_file import write_bytes_atomically
from device.blocks import peak
from device.drive.outputs import AlignedOutput
from device.errors import UsageError
from device.units import Float32Array, FloatArray, db_to_amplitude

DURATION_MAX_S = 3 * 3600.0
"""Longest sound of formats whose file must be made as a whole."""

Progress = Callable[[int, int | None], None]


@dataclass(frozen=True)
class Composed:
    """What a writer has written: measured errors, and warnings."""

    error: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


class Writer(Protocol):
    """Makes a file from the glides of all channels of vibration."""

    def add(self, voice: int, rows: FloatArray, frame: int) -> None:
        """Take a channel's glides; all that begin before the frame are there."""
        ...

    def finish(self, duration_s: float) -> Composed:
        """Write the file."""
        ...

    def abort(self) -> None:
        """Discard the file."""
        ...


@dataclass(frozen=True)
class Job:
    """What a writer needs to know. gain: factor on amplitudes. channels: of vibration."""

    target: Path
    settings: Settings
    options: ExportOptions
    design: LiveDesign
    channels: int
    gain: float


Compose = Callable[[VibrationCurve, float, Job], tuple[bytes, Composed]]


class CurveWriter:
    """Writes a format that is made from the curve of one channel. Use from one thread.

    compose: makes the file's content from the curve, the duration in seconds and the job.
    """

    def __init__(self, job: Job, compose: Compose) -> None:
        self._job, self._compose = job, compose
        self._reader = CurveReader(job.design, job.gain)

    def add(self, voice: int, rows: FloatArray, frame: int) -> None:
        """Take glides, until the sound is too long for such a file."""
        check_duration(frame / self._job.design.samplerate, self._job.options.format)
        self._reader.add(rows, frame)

    def finish(self, duration_s: float) -> Composed:
        """Write the file."""
        content, composed = self._compose(self._reader.curve(duration_s), duration_s, self._job)
        write_bytes_atomically(self._job.target, content)
        return composed

    def abort(self) -> None:
        """Do nothing: the file is written at the end."""


class _Heard:
    """Takes the vibration without keeping it, and knows its peak."""

    def __init__(self, samplerate: int, channels: int) -> None:
        self.samplerate, self.channels = samplerate, channels
        self.peak = 0.0

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take a block."""
        self.peak = max(self.peak, peak(vibration)) if len(vibration) else self.peak

    def close(self) -> None:
        """Do nothing."""

    def abort(self) -> None:
        """Do nothing."""


def check_duration(duration_s: float, name: str) -> None:
    """Raise UsageError if a sound is too long for a format that is made as a whole."""
    if duration_s > DURATION_MAX_S:
        raise UsageError(
            f"the sound is longer than the format {name} may hold; allowed: "
            f"{DURATION_MAX_S / 3600:g} hours; cut it, or choose one of: partials, wav, flac"
        )


def refuse_settings(name: str, settings: Settings) -> None:
    """Raise UsageError for settings that a format without a waveform cannot hold."""
    unheld = {
        "transform": settings.form != "live",
        "damping": settings.damping != "off",
        "protection": settings.protection != "off",
        "exposure_cap": settings.exposure_cap != "off",
        "actuator": bool(settings.actuators),
    }
    if unheld["transform"]:
        raise UsageError(
            f"transform = {settings.form!r} tracks no partials, from which the format {name} is "
            "made; allowed: live; use --transform live, or the format wav or flac"
        )
    if wrong := [key for key, there in unheld.items() if there]:
        raise UsageError(
            f"the format {name} describes vibration for any actuator and cannot hold "
            f"{', '.join(wrong)}, which shape the waveform for one rig; allowed: off, and no "
            "[[actuator]]; change the config, or use the format wav or flac"
        )


def export_parametric(
    open_writer: Callable[[Job], Writer],
    client: Client,
    target: Path,
    settings: Settings,
    options: ExportOptions,
    progress: Progress | None,
    warnings: Sequence[str],
    watch: Watch | None = None,
) -> ExportReport:
    """Play a client's sound, let a writer make the file, and return the report.

    Raises as `export`.
    """
    name = options.format
    refuse_settings(name, settings)
    if FORMATS[name].whole and client.frames_expected:
        check_duration(client.frames_expected / client.samplerate, name)
    framework = Framework(
        client.samplerate, client.channels, settings, hal_frames=OFFLINE_HAL_FRAMES
    )
    rate, channels = framework.samplerate, framework.haptic_channels
    check_channel_count(name, channels)
    design = LiveDesign.of(settings.parameters, rate)
    job = Job(target, settings, options, design, channels, db_to_amplitude(settings.gain_db))
    framework.take_glides()  # starts the recording
    heard = _Heard(rate, channels)
    meter = LeakMeter(heard, watch)
    writer = open_writer(job)
    try:
        chain = Pipeline(client, framework, [AlignedOutput(meter, framework.latency_frames)])
        frames = played = 0
        while step := chain.step():
            framework.check_haptics()
            frames += len(step.audio)
            played += len(step.vibration)
            rows = framework.take_glides()
            for voice in range(channels):
                writer.add(voice, rows[rows[:, VOICE] == voice], played)
            if progress:
                progress(frames, client.frames_expected)
        chain.close()
        composed = writer.finish(frames / rate)
    except BaseException:
        writer.abort()
        raise
    return ExportReport(
        format=name,
        frames=frames,
        samplerate=rate,
        channels=channels,
        duration_s=frames / rate,
        profile=settings.profile,
        peak=heard.peak,
        leak_above_250_hz_db=meter.leak_db,
        limited_samples=framework.limited_samples,
        replaced_samples=framework.replaced_samples,
        bytes=target.stat().st_size,
        error=composed.error,
        warnings=[*framework.warnings, *framework.bypass_warnings(), *warnings, *composed.warnings],
    )
