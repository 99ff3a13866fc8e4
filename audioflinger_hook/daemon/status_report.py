"""What a running daemon tells about itself, gathered from all its parts."""

from __future__ import annotations

import os
from dataclasses import replace

from audioflinger_hook import __version__
from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.service.status import (
    ActuatorFigures,
    DelayLineFigures,
    Endpoint,
    ExposureFigures,
    LatencyBudget,
    Levels,
    ProtectionFigures,
    Status,
    Xruns,
)
from device.drive.driving import Driving


def status_of(supervisor: Supervisor, now_s: float) -> Status:
    """Return the whole picture at `now_s`. Any thread may call it; the audio does not notice."""
    report = supervisor.states.report(now_s)
    tap, device = supervisor.endpoints
    engine = supervisor.engine
    status = Status(
        version=__version__,
        pid=os.getpid(),
        state=report.state,
        reason=report.reason,
        since_s=report.since_s,
        tap=Endpoint(*tap),
        device=Endpoint(*device),
        xruns=Xruns(*supervisor.xruns),
        recoveries=report.recoveries,
        warnings=tuple(supervisor.warnings),
    )
    if engine is None:
        return status
    line = engine.delay_line.status
    tap_s, output_s = supervisor.latencies_s
    offset_s = engine.delay_line.offset_s
    actuators = _actuators(engine)
    later_ms, delay_ms = _later_ms(engine)
    return replace(
        status,
        levels=Levels(engine.sound.meter.level(), engine.vibration.meter.level()),
        latency=LatencyBudget.of(
            tap_ms=1e3 * tap_s,
            transform_ms=1e3 * engine.framework.latency_s,
            delay_line_ms=1e3 * (line.delay_s - offset_s),
            output_ms=1e3 * output_s,
            offset_ms=1e3 * supervisor.offset_s,
            driving_ms=later_ms,
            delay_ms=delay_ms,
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
        actuators=actuators,
        profile=engine.framework.settings.profile,
    )


def _later_ms(engine: Engine) -> tuple[float, float]:
    """What is done for the rigs adds, and what the last of the actuators was asked to add, ms."""
    ms = 1e3 / engine.samplerate
    if engine.actuators is not None:
        actuators = engine.actuators
        return ms * actuators.latency_frames, ms * max(actuators.delays_frames)
    return (ms * engine.driving.latency_frames if engine.driving else 0.0), 0.0


def _drivings(engine: Engine) -> list[Driving]:
    """What is done for rigs, one or several."""
    every = engine.actuators.drivings if engine.actuators else (engine.driving,)
    return [driving for driving in every if driving is not None]


def _worst_protection(engine: Engine) -> ProtectionFigures | None:
    found = [_protection(driving) for driving in _drivings(engine)]
    return min(found, key=lambda one: (one.gain, one.least_gain), default=None)


def _worst_exposure(engine: Engine) -> ExposureFigures | None:
    found = [_exposure(driving) for driving in _drivings(engine)]
    return max(found, key=lambda one: one.a8_m_s2, default=None)


def _actuators(engine: Engine) -> tuple[ActuatorFigures, ...]:
    actuators = engine.actuators
    if actuators is None:
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
            protection=_protection(driving) if driving else None,
            exposure=_exposure(driving) if driving else None,
        )
        for chosen, driving, gathered in zip(
            actuators.settings, actuators.drivings, engine.driven, strict=True
        )
    )


def _protection(driving: Driving) -> ProtectionFigures:
    seen = driving.protection()
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
    )


def _exposure(driving: Driving) -> ExposureFigures:
    dose = driving.exposure()
    return ExposureFigures(
        time_s=dose.time_s,
        running_m_s2=dose.running_m_s2,
        a8_m_s2=dose.a8_m_s2,
        vdv=dose.vdv,
        above_action=dose.above_action,
        above_limit=dose.above_limit,
        extrapolated=dose.extrapolated,
        knows_seat=driving.knows_seat,
        cap=driving.exposure_cap,
        cap_gain=driving.exposure_gain,
    )
