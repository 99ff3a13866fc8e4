"""What a running daemon tells about itself, gathered from all its parts."""

from __future__ import annotations

import os
from dataclasses import replace

from audioflinger_hook import __version__
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.service.status import (
    DelayLineFigures,
    Endpoint,
    LatencyBudget,
    Levels,
    Status,
    Xruns,
)


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
    return replace(
        status,
        levels=Levels(engine.sound.meter.level(), engine.vibration.meter.level()),
        latency=LatencyBudget.of(
            tap_ms=1e3 * tap_s,
            transform_ms=1e3 * engine.framework.latency_s,
            delay_line_ms=1e3 * (line.delay_s - offset_s),
            output_ms=1e3 * output_s,
            offset_ms=1e3 * supervisor.offset_s,
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
    )
