"""The function `export`, which writes the vibration of a sound in any format."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.exports import ahap, haptic_clip, parametric, vibration_xml
from audioflinger_hook.exports.hjif import HjifWriter
from audioflinger_hook.exports.ogg_haptic import OggHapticOutput
from audioflinger_hook.exports.options import (
    FORMATS,
    ExportOptions,
    ExportReport,
    check_channel_count,
    format_of,
    held_rate_hz,
)
from audioflinger_hook.exports.sound_output import (
    BackgroundOutput,
    LeakMeter,
    SoundFileOutput,
    Watch,
    resampled,
)
from audioflinger_hook.offline.render import Progress, render
from audioflinger_hook.pipeline.framework import Framework
from audioflinger_hook.pipeline.step import Step
from audioflinger_hook.sources import Client
from device.drive.outputs import FADE_S
from device.output import VibrationOutput
from device.wav_output import WavOutput

__all__ = ["FORMATS", "ExportOptions", "ExportReport", "export", "format_of"]

WRITERS: dict[str, Callable[[parametric.Job], parametric.Writer]] = {
    "ahap": lambda job: parametric.CurveWriter(job, ahap.compose),
    "haptic": lambda job: parametric.CurveWriter(job, haptic_clip.compose),
    "vibration-xml": lambda job: parametric.CurveWriter(job, vibration_xml.compose),
    "hjif": HjifWriter,
    "partials": parametric.PartialLines,
}


def export(
    client: Client,
    target: Path,
    settings: Settings,
    options: ExportOptions,
    progress: Progress | None = None,
    warnings: Sequence[str] = (),
    watch: Watch | None = None,
) -> ExportReport:
    """Write the vibration of a client's sound in any format. The file appears only when complete.

    The same sound, settings and options give the same bytes. The client is closed. Any thread may
    call this function.

    options: determine the format; the target's suffix does not. watch: receives the vibration
        before the sample rate is converted.
    Other parameters and errors: see `render`.
    UsageError: also if the format cannot represent the sound or the settings.
    """
    name = options.format
    file: VibrationOutput
    meter: LeakMeter
    background: BackgroundOutput | None
    rate: int  # of the file

    def open_file(path: Path, samplerate: int, channels: int) -> VibrationOutput:
        nonlocal file, meter, background, rate
        check_channel_count(name, channels)
        rate = options.output_rate_hz or held_rate_hz(name, samplerate)
        if name in WRITERS:
            file = parametric.DescribedOutput(
                path, samplerate, channels, settings, options, WRITERS[name]
            )
        elif name == "flac":
            file = SoundFileOutput(path, rate, channels, "FLAC", "PCM_24")
        elif name == "ogg-haptic":
            file = OggHapticOutput(path, samplerate, rate, client.channels, channels)
        else:
            file = WavOutput(path, rate, channels)
        meter = LeakMeter(resampled(file, samplerate), watch)
        background = BackgroundOutput(meter) if name in ("flac", "ogg-haptic") else None
        return background or meter

    def observe(framework: Framework) -> Callable[[Step], None] | None:
        if isinstance(file, OggHapticOutput):
            assert background
            run, hear = background.run, file.hear
            return lambda step: run(hear, step.audio)
        return file.observe(framework) if isinstance(file, parametric.DescribedOutput) else None

    with closing(client):
        if name in WRITERS:
            parametric.refuse_settings(name, settings)
            # The file is for any actuator, so no rig's resonance is compensated.
            settings = replace(settings, said=(*settings.said, "strength"))
        if FORMATS[name].whole and client.frames_expected:
            parametric.check_duration(client.frames_expected / client.samplerate, name)
        report = render(
            client,
            target,
            settings,
            progress=progress,
            warnings=warnings,
            fade_s=0.0 if name in WRITERS else FADE_S,
            open_output=open_file,
            observe=observe,
        )
    limited = getattr(file, "limited_samples", 0)
    more = [f"{limited} samples beyond full scale were limited"] if limited else []
    if rate != (options.output_rate_hz or report.samplerate):
        more.append(f"the format {name} cannot have {report.samplerate} Hz; the file has {rate} Hz")
    composed = (
        file.composed if isinstance(file, parametric.DescribedOutput) else parametric.Composed()
    )
    return ExportReport(
        format=name,
        frames=-(-report.frames * rate // report.samplerate),
        samplerate=rate,
        channels=report.channels,
        duration_s=report.frames / report.samplerate,
        profile=report.profile,
        peak=report.peak,
        leak_above_250_hz_db=meter.leak_db,
        limited_samples=report.limited_samples + limited,
        replaced_samples=report.replaced_samples,
        bytes=target.stat().st_size,
        exposure=report.exposure,
        error=composed.error,
        warnings=[*report.warnings, *more, *composed.warnings],
    )
