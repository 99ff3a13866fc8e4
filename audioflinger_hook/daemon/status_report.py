"""The status of a running daemon, collected from its parts."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

from audioflinger_hook import __version__
from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.native.figures import with_native
from audioflinger_hook.daemon.rig_figures import (
    exposure_figures,
    exposure_of,
    protection_figures,
    protection_of,
)
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.service.meters import level_of
from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import (
    ActuatorFigures,
    DelayLineFigures,
    DeviceRateFigures,
    Endpoint,
    LatencyBudget,
    Levels,
    Partial,
    Status,
    Xruns,
)
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
        return with_native(status, native, supervisor)
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
        protection=protection_of(drive.processors),
        exposure=exposure_of(drive.processors, supervisor.engines.dose_since),
        actuators=_actuators(engine, supervisor.engines.dose_since),
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


def _actuators(engine: Engine, since: str) -> tuple[ActuatorFigures, ...]:
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
            protection=protection_figures(processor),
            exposure=exposure_figures(processor, since),
        )
        for chosen, processor, gathered in zip(
            drive.settings, drive.processors, engine.driven, strict=True
        )
    )
