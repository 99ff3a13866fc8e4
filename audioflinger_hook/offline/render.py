"""Offline rendering: a sound in, a vibration file out, through the same pipeline as live sound."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.sections import Plan, plan_for, sections_of
from audioflinger_hook.pipeline.framework import (
    OFFLINE_HAL_FRAMES,
    Framework,
    channel_map_of,
    drive_of,
    simulated_rig_of,
)
from audioflinger_hook.pipeline.step import HapticSink, Pipeline
from audioflinger_hook.sources import Client, FileTap, TapClient
from device.drive.channel_map import ChannelMap
from device.drive.outputs import AlignedOutput, DrivenOutput
from device.errors import UsageError
from device.output import VibrationOutput
from device.rig.instruments import ACCELERATION_FULL_SCALE_M_S2
from device.rig.simulated_rig import SimulatedRig
from device.wav_output import WavOutput

Progress = Callable[[int, int | None], None]
"""Takes, after every buffer, the frames done and the frames in all (None if not known)."""

Wait = Callable[[int], None]
"""Takes the frames done, and returns when the next are due."""

ACCELERATION_COMMENT = (
    f"predicted acceleration, full scale = {ACCELERATION_FULL_SCALE_M_S2:g} m/s^2"
)


@dataclass(frozen=True)
class RenderReport:
    """What was rendered. Field names carry their units; frames and samples are counts."""

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
    warnings: list[str] = field(default_factory=list)


def render_file(
    source: Path,
    target: Path,
    settings: Settings | None = None,
    *,
    acceleration: Path | None = None,
    progress: Progress | None = None,
    workers: int = 1,
) -> RenderReport:
    """Write the vibration of a sound file as float32 WAV of the same rate and length.

    With several workers, call it from the main thread. Errors are those of `render`.

    Parameters
    ----------
    source : Path
        The sound file.
    target : Path
        The WAV file to create or replace.
    settings : Settings, optional
        What a config file holds; its defaults otherwise.
    acceleration : Path, optional
        Where the rig's acceleration goes, as WAV.
    progress : callable, optional
        Called after every buffer with the frames done and the frames in all.
    workers : int
        Processes that may share the work where the form allows it; the bytes are the same.
    """
    refuse_same_file(source, target, acceleration)
    settings = settings or Settings()
    if workers > 1 and (plan := plan_for(source, settings)):
        return _render_sections(plan, workers, target, acceleration, progress)
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
) -> RenderReport:
    """Write the vibration of what a client plays as float32 WAV of the mix's rate and length.

    The latency is taken out, so that vibration lies under its sound, apart from the delays that
    actuators were given. Files appear whole or not at all, and the client is closed. Memory does
    not depend on the length. Any one thread may call it.

    client: plays the sound.
    target: the vibration's file. It has the channels of the device up to the last one with an
        actuator; without named actuators one, or with `channels` = "each" those of the mix.
    settings: how vibration is made.
    acceleration: also simulate the rig, and write here what its accelerometer records, full scale
        100 m/s².
    progress: takes the progress after every buffer.
    wait: called before every buffer, to keep a pace.
    warnings: warnings about the source, complete when it has ended.
    UsageError: the source cannot be used, or a target cannot be written.
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
        rig, written = _open_outputs(outputs, target, acceleration, settings, framework)
        chain = Pipeline(client, framework, [taken for _, taken in written])
        frames = 0
        while step := chain.step():
            framework.check_haptics()
            frames += len(step.audio)
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
    return RenderReport(
        frames=frames,
        samplerate=rate,
        channels=outputs[0].channels,
        transform=settings.form,
        profile=settings.profile,
        latency_s=framework.latency_s,
        peak=written[0][0].peak,
        limited_samples=framework.limited_samples,
        replaced_samples=framework.replaced_samples,
        peak_acceleration_m_s2=rig.peak_acceleration_m_s2 if rig else None,
        warnings=[*framework.warnings, *framework.bypassed(), *warnings],
    )


def _render_sections(
    plan: Plan,
    workers: int,
    target: Path,
    acceleration: Path | None,
    progress: Progress | None,
) -> RenderReport:
    """Do as `render`, with vibration that comes in sections."""
    settings = plan.settings
    outputs: list[VibrationOutput] = []
    frames = replaced = 0
    try:
        framework = Framework(
            plan.samplerate, plan.channels, settings, hal_frames=OFFLINE_HAL_FRAMES
        )
        rig, written = _open_outputs(outputs, target, acceleration, settings, framework)
        sink = HapticSink(*(taken for _, taken in written), clip=False)
        # What is aligned for the framework's latency gets that before the first section.
        sink.send(np.zeros((framework.latency_frames, framework.haptic_channels), np.float32))
        with closing(sections_of(plan, workers)) as sections:
            for section in sections:
                for first in range(0, len(section.vibration), OFFLINE_HAL_FRAMES):
                    part = section.vibration[first : first + OFFLINE_HAL_FRAMES]
                    sink.send(part)
                    frames += len(part)
                    if progress:
                        progress(frames, plan.sections * plan.frames)
                replaced += section.replaced_samples
        for output in reversed([taken for _, taken in written]):
            output.close()
    except BaseException:
        for output in outputs:
            output.abort()
        raise
    return RenderReport(
        frames=frames,
        samplerate=plan.samplerate,
        channels=outputs[0].channels,
        transform=settings.form,
        profile=settings.profile,
        latency_s=framework.latency_s,
        peak=written[0][0].peak,
        limited_samples=0,
        replaced_samples=replaced,
        peak_acceleration_m_s2=rig.peak_acceleration_m_s2 if rig else None,
        warnings=[*framework.warnings, *section.warnings],
    )


def _open_outputs(
    outputs: list[VibrationOutput],
    target: Path,
    acceleration: Path | None,
    settings: Settings,
    framework: Framework,
) -> tuple[SimulatedRig | None, list[tuple[AlignedOutput, VibrationOutput]]]:
    """Add what is written to `outputs`; return the simulated rig, and each output as `_driven`."""
    rate = framework.samplerate
    channel_map = channel_map_of(settings, framework.haptic_channels)
    outputs.append(WavOutput(target, rate, channel_map.channels))
    rig: SimulatedRig | None = None
    if acceleration is not None:
        recorder = WavOutput(acceleration, rate, channel_map.channels, comment=ACCELERATION_COMMENT)
        rig = simulated_rig_of(settings, rate, channel_map, recorder)
        outputs.append(rig)
    return rig, [_driven(output, channel_map, framework) for output in outputs]


def _driven(
    output: VibrationOutput, channel_map: ChannelMap, framework: Framework
) -> tuple[AlignedOutput, VibrationOutput]:
    """Return what knows the peak of all that is written, and what takes the vibration.

    The drive stands between them, and the latency of transform and drive is taken out.
    """
    drive = drive_of(framework.settings, framework.samplerate, framework.haptic_channels)
    if drive.sources:
        # Behind the drive: a delayed actuator starts with what precedes the sound.
        written = AlignedOutput(output, framework.latency_frames + drive.latency_frames)
        return written, DrivenOutput(written, drive, channel_map)
    written = AlignedOutput(output, drive.latency_frames)
    driven = DrivenOutput(written, drive, channel_map)
    return written, AlignedOutput(driven, framework.latency_frames)


def refuse_same_file(source: Path, target: Path, acceleration: Path | None) -> None:
    """Raise UsageError where one of the files would overwrite another."""
    named = {"the input": source, "the vibration": target}
    if acceleration is not None:
        named["the acceleration"] = acceleration
    seen: dict[str, str] = {}
    for role, path in named.items():
        resolved = os.path.realpath(path)
        if resolved in seen:
            raise UsageError(f"{path} is named for {seen[resolved]} and for {role}; name two files")
        seen[resolved] = role
