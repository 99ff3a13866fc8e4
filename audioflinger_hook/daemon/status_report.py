"""The status of a running daemon, collected from its parts."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

from audioflinger_hook import __version__
from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.native.figures import with_native
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.service.meters import level_of
from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import (
    ActuatorFigures,
    DelayLineFigures,
    DeviceRateFigures,
    Endpoint,
    ExposureFigures,
    LatencyBudget,
    Levels,
    Partial,
    ProtectionFigures,
    Status,
    Xruns,
)
from device.drive.rig_processor import RigProcessor
from device.units import db_to_amplitude


def status_of(supervisor: Supervisor, now_s: float) -> Status:
    """Return the status at `now_s`. Any thread may call it; audio threads do not wait for it."""
    report = supervisor.states.report(now_s)
    tap, device = supervisor.endpoints
    engine, native = supervisor.engine, supervisor.engines.switch.native
    status = Status(
        version=__version__,
        pid=os.getpid(),
        state=report.state,
        reason=report.reason,
        since_s=report.since_s,
        tap=Endpoint(*tap),
        device=Endpoint(*device),
        xruns=Xruns(supervisor.input.xruns, supervisor.output.xruns),
        recoveries=report.recoveries,
        warnings=tuple(supervisor.warnings),
        engine_reason=supervisor.engines.switch.reason,
        engine_pid=native.process_id if native else 0,
        volume_db=supervisor.engines.volume_db,
        device_rate=_device_rate(supervisor),
        applications=supervisor.applications,
        muted=supervisor.config.muted,
        server=supervisor.server,
        principal=tuple(Partial(*partial) for partial in _principal(supervisor)),
    )
    if native is not None and native.audible:
        return with_native(status, native, supervisor.config.settings, supervisor.offset_s)
    if engine is None:
        return status
    line = engine.delay_line.status
    tap_s, output_s = supervisor.latencies_s
    ms, drive = 1e3 / engine.samplerate, engine.drive
    return replace(
        status,
        levels=Levels(
            engine.sound.meter.level(),
            engine.vibration.meter.level(),
            tuple(level_of(*one) for one in engine.sound.meter.channel_readings()),
        ),
        latency=LatencyBudget.of(
            tap_ms=1e3 * tap_s,
            transform_ms=1e3 * engine.framework.latency_s,
            delay_line_ms=1e3 * (line.delay_s - engine.delay_line.offset_s),
            output_ms=1e3 * output_s,
            offset_ms=1e3 * supervisor.offset_s,
            driving_ms=ms * drive.latency_frames,
            delay_ms=ms * max(drive.delays_frames, default=0),
        ),
        delay_line=DelayLineFigures(
            1e3 * line.target_s,
            1e3 * line.delay_s,
            line.ratio_ppm,
            line.resyncs,
            line.underflows,
            line.overflows,
            line.state.value,
        ),
        buffer_times=engine.buffer_times.times(),
        effects_bypassed=tuple(engine.framework.bypassed()),
        limited_samples=engine.framework.limited_samples,
        replaced_samples=engine.framework.replaced_samples,
        protection=_worst_protection(engine),
        exposure=_worst_exposure(engine),
        actuators=_actuators(engine),
        profile=engine.framework.settings.profile,
        engine="python",
    )


def _device_rate(supervisor: Supervisor) -> DeviceRateFigures | None:
    found = supervisor.output.measure_rate()
    return DeviceRateFigures(found.nominal_hz, found.measured_hz, found.ppm) if found else None


def _principal(supervisor: Supervisor) -> Sequence[tuple[float, float, float]]:
    engine, native = supervisor.engine, supervisor.engines.switch.native
    told: Sequence[tuple[float, float, float]] = ()
    if supervisor.states.state is DaemonState.RUNNING:
        if native is not None and native.audible:
            told = native.page.principal() if native.page else ()
        elif engine is not None:
            told = engine.framework.principal
    return _as_played(told, supervisor.config)


def _as_played(
    partials: Sequence[tuple[float, float, float]], config: RunConfig
) -> Sequence[tuple[float, float, float]]:
    """Return partials at the level that is played."""
    gain_db = config.settings.gain_db
    if gain_db == 0.0 and not config.muted:
        return partials
    level = 0.0 if config.muted else db_to_amplitude(gain_db)
    return [(audio_hz, hz, level * amplitude) for audio_hz, hz, amplitude in partials]


def _worst_protection(engine: Engine) -> ProtectionFigures | None:
    found = [_protection(one) for one in engine.drive.processors if one]
    return min(found, key=lambda one: (one.gain, one.least_gain), default=None)


def _worst_exposure(engine: Engine) -> ExposureFigures | None:
    return worst_exposure([_exposure(one) for one in engine.drive.processors if one])


def worst_exposure(found: Sequence[ExposureFigures]) -> ExposureFigures | None:
    """Return each reading of the actuator where it is worst; None without actuators."""
    if not found:
        return None
    most = max(found, key=lambda one: one.a8_m_s2)
    capped = min(found, key=lambda one: one.cap_gain)
    return replace(
        most,
        time_s=max(one.time_s for one in found),
        running_m_s2=max(one.running_m_s2 for one in found),
        vdv=max(one.vdv for one in found),
        above_action=any(one.above_action for one in found),
        above_limit=any(one.above_limit for one in found),
        cap=capped.cap,
        cap_gain=capped.cap_gain,
    )


def _actuators(engine: Engine) -> tuple[ActuatorFigures, ...]:
    drive = engine.drive
    if not drive.settings:
        return ()
    return tuple(
        ActuatorFigures(
            source=chosen.source,
            channels=tuple(map(str, chosen.channels)),
            rig=chosen.rig or engine.framework.settings.rig,
            gain_db=chosen.gain_db,
            polarity=chosen.polarity,
            delay_ms=chosen.delay_ms,
            level=gathered.meter.level(),
            protection=_protection(processor) if processor else None,
            exposure=_exposure(processor) if processor else None,
        )
        for chosen, processor, gathered in zip(
            drive.settings, drive.processors, engine.driven, strict=True
        )
    )


def _protection(processor: RigProcessor) -> ProtectionFigures:
    seen = processor.protection()
    return ProtectionFigures(
        blocks=seen.blocks,
        limited_blocks=seen.limited_blocks,
        infeasible_blocks=seen.infeasible_blocks,
        replaced_samples=seen.replaced_samples,
        gain=seen.gain,
        least_gain=seen.least_gain,
        limited_by=seen.limited_by,
        excursion_mm=1e3 * seen.excursion_m,
        coil_c=seen.coil_c,
        makeup_db=processor.makeup_db,
        strength_db=processor.strength_db,
    )


def _exposure(processor: RigProcessor) -> ExposureFigures:
    dose = processor.exposure()
    return ExposureFigures(
        time_s=dose.time_s,
        running_m_s2=dose.running_m_s2,
        a8_m_s2=dose.a8_m_s2,
        vdv=dose.vdv,
        above_action=dose.above_action,
        above_limit=dose.above_limit,
        extrapolated=dose.extrapolated,
        knows_seat=processor.knows_seat,
        cap=processor.exposure_cap,
        cap_gain=processor.exposure_gain,
    )
