"""The native engine's part of the status."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from audioflinger_hook.daemon.native.engine import NativeEngine
from audioflinger_hook.daemon.native.page import TransformReadings
from audioflinger_hook.daemon.rig_figures import (
    exposure_figures,
    exposure_of,
    protection_figures,
    protection_of,
)
from audioflinger_hook.service.meters import Level, level_of
from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import (
    ActuatorFigures,
    GraphFigures,
    LatencyBudget,
    Levels,
    Status,
    Xruns,
)

if TYPE_CHECKING:
    from audioflinger_hook.daemon.supervisor import Supervisor


def _tap_ms(native: NativeEngine, readings: TransformReadings) -> float:
    """Return the delay of the tap: the monitor of a sink that drives is read one cycle late."""
    if not native.monitor_reason or not readings.samplerate:
        return 0.0
    return 1e3 * readings.cycle_frames / readings.samplerate


def with_native(status: Status, native: NativeEngine, supervisor: Supervisor) -> Status:
    """Return a status with the figures of a native engine that plays. Any thread may call it.

    Tap and device belong to one cycle of the graph, so only transform and protection delay the
    vibration, and a monitor that is tapped.
    """
    settings, since = supervisor.config.settings, supervisor.engines.dose_since
    plan, page, readings = native.plan, native.page, native.readings()
    if plan is None or page is None or readings is None:
        return status
    resting = status.state is DaemonState.IDLE
    ms, rigs = 1e3 / plan.samplerate, native.rigs
    latency_frames = max((rig.latency_frames for rig in rigs if rig), default=0)
    delays_ms = [actuator.delay_ms for actuator in settings.actuators]
    return replace(
        status,
        # While the graph rests, the plugin does not run, and its last levels stay.
        levels=Levels()
        if resting
        else Levels(
            readings.sound,
            readings.vibration,
            tuple(level_of(*reading) for reading in page.channel_readings()),
        ),
        latency=LatencyBudget.of(
            tap_ms=_tap_ms(native, readings),
            transform_ms=ms * plan.transform.latency_frames,
            offset_ms=1e3 * supervisor.offset_s,
            driving_ms=ms * latency_frames,
            delay_ms=max(delays_ms, default=0.0),
        ),
        server=native.server,
        graph=GraphFigures(
            cycle_frames=readings.cycle_frames,
            samplerate=readings.samplerate,
            tap="monitor" if native.monitor_reason else "streams",
            tap_reason=native.monitor_reason,
        ),
        xruns=Xruns(native.errors.count(".tap"), native.errors.count(".vibration")),
        limited_samples=readings.limited_samples,
        replaced_samples=readings.replaced_samples,
        actuators=tuple(
            ActuatorFigures(
                source=actuator.source,
                channels=tuple(map(str, actuator.channels)),
                rig=actuator.rig or settings.rig,
                gain_db=actuator.gain_db,
                polarity=actuator.polarity,
                delay_ms=actuator.delay_ms,
                level=Level() if resting else native.level(slot),
                protection=protection_figures(rig),
                exposure=exposure_figures(rig, since),
            )
            for slot, (actuator, rig) in enumerate(zip(settings.actuators, rigs, strict=False))
        ),
        protection=protection_of(rigs),
        exposure=exposure_of(rigs, since),
        profile=settings.profile,
        engine="native",
        engine_reason="",
    )
