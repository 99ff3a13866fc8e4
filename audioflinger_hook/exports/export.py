"""`export`: a client's sound as a file of any format."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.exports import ahap, haptic_clip, vibration_xml
from audioflinger_hook.exports.decimation import LeakMeter, ResampledOutput, Watch
from audioflinger_hook.exports.hjif import HjifWriter
from audioflinger_hook.exports.ogg_haptic import OggHapticOutput
from audioflinger_hook.exports.options import (
    FORMATS,
    ExportOptions,
    ExportReport,
    check_channel_count,
    format_of,
)
from audioflinger_hook.exports.parametric import CurveWriter, Job, Writer, export_parametric
from audioflinger_hook.exports.partial_lines import PartialLines
from audioflinger_hook.exports.sound_output import SoundFileOutput
from audioflinger_hook.offline.render import Progress, RenderReport, render
from audioflinger_hook.sources import Client
from device.output import VibrationOutput
from device.wav_output import WavOutput

__all__ = ["FORMATS", "ExportOptions", "ExportReport", "export", "format_of"]


def export(
    client: Client,
    target: Path,
    settings: Settings,
    options: ExportOptions,
    progress: Progress | None = None,
    warnings: Sequence[str] = (),
    watch: Watch | None = None,
) -> ExportReport:
    """Write the vibration of a client's sound in any format; the file appears whole or not at all.

    Equal sound, settings and options give equal bytes. The client is closed. Any one thread may
    call it.

    client: plays the sound.
    target: the file to create or replace. Its name is free; `options` say the format.
    settings: how vibration is made, as for `render`.
    options: format, rate and band.
    progress: called after every buffer.
    warnings: warnings about the source, complete when it has ended.
    watch: called with the vibration, block by block, at the sound's rate.
    UsageError: the format cannot hold what is asked, or the target cannot be written.
    WriteError: the disk is full or failed.
    InternalError: the haptic effect failed.
    """
    try:
        if open_writer := WRITERS.get(options.format):
            return export_parametric(
                open_writer, client, target, settings, options, progress, warnings, watch
            )
        return _Waveform(options, watch).export(client, target, settings, progress, warnings)
    finally:
        client.close()


WRITERS: dict[str, Callable[[Job], Writer]] = {
    "ahap": lambda job: CurveWriter(job, ahap.compose),
    "haptic": lambda job: CurveWriter(job, haptic_clip.compose),
    "vibration-xml": lambda job: CurveWriter(job, vibration_xml.compose),
    "hjif": HjifWriter,
    "partials": PartialLines,
}
"""What writes each parametric format."""


class _Waveform:
    """Exports the vibration itself: renders it to an output that this opens."""

    def __init__(self, options: ExportOptions, watch: Watch | None) -> None:
        self._options = options
        self._watch = watch
        self._audio_channels = 0
        self._file: VibrationOutput | None = None
        self._meter: LeakMeter | None = None

    def export(
        self,
        client: Client,
        target: Path,
        settings: Settings,
        progress: Progress | None,
        warnings: Sequence[str],
    ) -> ExportReport:
        self._audio_channels = client.channels
        report = render(
            client,
            target,
            settings,
            progress=progress,
            warnings=warnings,
            open_output=self._open,
            hear=self._hear,
        )
        assert self._file is not None
        assert self._meter is not None
        frames = -(-report.frames * self._file.samplerate // report.samplerate)
        limited = getattr(self._file, "limited_samples", 0)
        found = report_of(report, self._options.format, target, self._meter.leak_db)
        more = [f"{limited} samples beyond full scale were limited"] if limited else []
        return replace(
            found,
            frames=frames,
            samplerate=self._file.samplerate,
            limited_samples=found.limited_samples + limited,
            warnings=found.warnings + more,
        )

    def _hear(self, sound: NDArray[np.float32]) -> None:
        if isinstance(self._file, OggHapticOutput):
            self._file.hear(sound)

    def _open(self, path: Path, samplerate: int, channels: int) -> VibrationOutput:
        name = self._options.format
        check_channel_count(name, channels)
        rate = self._options.output_rate_hz or samplerate
        if name == "flac":
            self._file = SoundFileOutput(path, rate, channels, "FLAC", "PCM_24")
        elif name == "ogg-haptic":
            self._file = OggHapticOutput(path, rate, self._audio_channels, channels)
        else:
            self._file = WavOutput(path, rate, channels)
        converted = self._file if rate == samplerate else ResampledOutput(self._file, samplerate)
        self._meter = LeakMeter(converted, self._watch)
        return self._meter


def report_of(report: RenderReport, name: str, target: Path, leak_db: float | None) -> ExportReport:
    """Return the export's report for a rendering."""
    return ExportReport(
        format=name,
        frames=report.frames,
        samplerate=report.samplerate,
        channels=report.channels,
        duration_s=report.frames / report.samplerate,
        profile=report.profile,
        peak=report.peak,
        leak_above_250_hz_db=leak_db,
        limited_samples=report.limited_samples,
        replaced_samples=report.replaced_samples,
        bytes=target.stat().st_size,
        exposure=report.exposure,
        warnings=list(report.warnings),
    )
