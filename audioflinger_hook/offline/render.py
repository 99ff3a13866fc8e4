"""Offline rendering of sound to a file of vibration, with the same steps as for live sound."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.pipeline import framework as pipeline
from audioflinger_hook.pipeline.framework import OFFLINE_HAL_FRAMES, Framework, channel_map_of
from audioflinger_hook.pipeline.step import Pipeline, Step
from audioflinger_hook.sources import Client, FileTap, TapClient
from device.drive.exposure import Exposure
from device.drive.outputs import FADE_S, AlignedOutput, DrivenOutput, FadedOutput
from device.errors import UsageError
from device.output import VibrationOutput
from device.rig.electronics import ACCELERATION_FULL_SCALE_M_S2
from device.rig.model_record import SecondReport
from device.rig.simulated_rig import SimulatedRig
from device.wav_output import WavOutput

Progress = Callable[[int, int | None], None]  # frames done, and frames in total (None: unknown)
Wait = Callable[[int], None]  # called with the frames done; returns when the next buffer is due
OpenOutput = Callable[[Path, int, int], VibrationOutput]  # arguments: path, rate in Hz, channels
Observe = Callable[[Framework], Callable[[Step], None] | None]
"""Called before the first step. The returned function is called after every step."""

ACCELERATION_COMMENT = (
    f"predicted acceleration, full scale = {ACCELERATION_FULL_SCALE_M_S2:g} m/s^2"
)


@dataclass(frozen=True)
class RenderReport:
    """The result of a rendering. Field names contain their units; frames and samples are counts.

    strength_db: change in dB of a rig's Wk-weighted acceleration by damping and protection, for the
        rig with the lowest value.
    exposure: of the rig with the largest A(8); None without damping, protection and exposure cap.
    """

    frames: int
    samplerate: int
    channels: int
    transform: str
    profile: str
    latency_s: float
    peak: float
    limited_samples: int
    replaced_samples: int
    peak_acceleration_m_s2: float | None = None
    strength_db: float | None = None
    exposure: Exposure | None = None
    models: list[SecondReport] = field(default_factory=list)  # one report for each second
    warnings: list[str] = field(default_factory=list)


def render_file(
    source: Path,
    target: Path,
    settings: Settings | None = None,
    *,
    acceleration: Path | None = None,
    progress: Progress | None = None,
) -> RenderReport:
    """Write the vibration of a sound file as float32 WAV of the same rate and length.

    source, target: the sound file, and the WAV file to create or replace.
    settings: by default those of an empty config file.
    acceleration, progress: see `audioflinger_hook.offline.render.render`, also for exceptions.
    """
    refuse_same_file(source, target, acceleration)
    tap = FileTap(source)
    return render(
        TapClient(tap),
        target,
        settings,
        acceleration=acceleration,
        progress=progress,
        warnings=tap.warnings,
    )


def render(
    client: Client,
    target: Path,
    settings: Settings | None = None,
    *,
    acceleration: Path | None = None,
    progress: Progress | None = None,
    wait: Wait | None = None,
    warnings: Sequence[str] = (),
    fade_s: float = FADE_S,
    open_output: OpenOutput = WavOutput,
    observe: Observe | None = None,
) -> RenderReport:
    """Write the vibration of a client's sound as float32 WAV of the same rate and length.

    The latency of transform and drive is removed, so that vibration and sound are aligned, except
    for actuators' delays. Files appear only when complete. Any thread may call this function.
    client: the source of the sound, which is closed at the end.
    target: the vibration's file. With named actuators the file has the device's channels up to the
        last channel with an actuator. Without named actuators it has one channel, or with
        `channels` = "each" as many as the sound.
    acceleration: file for the rig's simulated acceleration, full scale 100 m/s²; None for none.
    progress: called after every buffer with the frames done and in total (None if unknown).
    wait: called with the frames done after every buffer; returns when the next buffer is due.
    warnings: warnings about the source, for the report; the list may grow until the source ends.
    fade_s: length of the fade at the end in seconds; 0 leaves all samples unchanged.
    UsageError: the source cannot be used, or a target cannot be created.
    WriteError: the disk is full or failed.
    InternalError: the haptic effect failed.
    """
    settings = settings or Settings()
    outputs: list[VibrationOutput] = []
    try:
        framework = Framework(
            client.samplerate, client.channels, settings, hal_frames=OFFLINE_HAL_FRAMES
        )
        rate = framework.samplerate
        channel_map = channel_map_of(settings, framework.haptic_channels)
        outputs.append(open_output(target, rate, channel_map.channels))
        rig: SimulatedRig | None = None
        if acceleration is not None:
            recorder = WavOutput(
                acceleration, rate, channel_map.channels, comment=ACCELERATION_COMMENT
            )
            rig = pipeline.simulated_rig_of(settings, rate, channel_map, recorder)
            outputs.append(rig)
        faded = [FadedOutput(output, round(fade_s * rate)) for output in outputs]
        drives = [pipeline.drive_of(settings, rate, framework.haptic_channels) for _ in faded]
        driven = []
        for after, drive in zip(faded, drives, strict=True):
            # A delayed actuator first plays frames from before the sound: remove them afterwards.
            late = framework.latency_frames if drive.sources else 0
            aligned = AlignedOutput(after, drive.latency_frames + late)
            before = DrivenOutput(aligned, drive, channel_map)
            driven.append(AlignedOutput(before, framework.latency_frames - late))
        chain = Pipeline(client, framework, driven)
        take = observe(framework) if observe else None
        frames = 0
        while step := chain.step():
            framework.check_haptics()
            frames += len(step.audio)
            if take:
                take(step)
            if progress:
                progress(frames, client.frames_expected)
            if wait:
                wait(frames)
        chain.close()
    except BaseException:
        for output in outputs:
            output.abort()
        raise
    finally:
        client.close()
    readings = [processor.exposure() for processor in drives[0].processors if processor]
    return RenderReport(
        frames=frames,
        samplerate=rate,
        channels=outputs[0].channels,
        transform=settings.form,
        profile=settings.profile,
        latency_s=framework.latency_s,
        peak=faded[0].peak,
        limited_samples=framework.limited_samples,
        replaced_samples=framework.replaced_samples,
        peak_acceleration_m_s2=rig.peak_acceleration_m_s2 if rig else None,
        strength_db=drives[0].strength_db,
        exposure=max(readings, key=lambda reading: reading.a8_m_s2, default=None),
        models=rig.seconds if rig else [],
        warnings=[*framework.warnings, *framework.bypass_warnings(), *warnings],
    )


def refuse_same_file(source: Path, target: Path, acceleration: Path | None) -> None:
    """Raise UsageError if two of the files are the same."""
    named = {"the input": source, "the vibration": target}
    if acceleration is not None:
        named["the acceleration"] = acceleration
    seen: dict[str, str] = {}
    for role, path in named.items():
        resolved = os.path.realpath(path)
        if resolved in seen:
            raise UsageError(f"{path} is named for {seen[resolved]} and for {role}; name two files")
        seen[resolved] = role
