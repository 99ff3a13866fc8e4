"""Collects the figures of `service/status.py`, and the levels that the live page shows."""

import itertools
import os
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

from audioflinger_hook import __version__
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.latency import parts_of_native, parts_of_python
from audioflinger_hook.daemon.native.chain import Chain
from audioflinger_hook.daemon.native.engine import NativeEngine
from audioflinger_hook.daemon.native.layout import Shown
from audioflinger_hook.daemon.safety_keeper import Rigs
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.service import status as figures
from audioflinger_hook.service.figure import gathered
from audioflinger_hook.service.meters import Level, level_of
from audioflinger_hook.service.state import DaemonState
from device.units import db_to_amplitude


def status_of(supervisor: Supervisor, now_s: float) -> figures.Status:
    """Return the status at `now_s`. Any thread may call it; audio threads do not wait."""
    engines, states, rate = supervisor.engines, supervisor.states, supervisor.output.measure_rate()
    python, native = engines.python, engines.native.engine
    chain = native.chain if native is not None else None
    tap, device = supervisor.endpoints
    sources: tuple[object, ...] = (supervisor, engines)
    xruns = figures.Xruns(supervisor.input.xruns, supervisor.output.xruns)
    values: dict[str, Any] = {"xruns": xruns}
    played: Sequence[tuple[float, float, float]] = ()
    level = 0.0 if supervisor.config.muted else db_to_amplitude(supervisor.config.settings.gain_db)
    if chain is not None:
        values["engine_pid"] = chain.process_id
    if native is not None and chain is not None and native.audible:
        sources = (chain.page, supervisor.config, *sources)
        played = chain.page.principal()
        values |= _of_native(native, chain, supervisor)
    elif python is not None:
        sources, played = (python.framework, *sources), python.framework.principal
        values |= _of_python(python, supervisor)
    return gathered(
        figures.Status,
        *sources,
        version=__version__,
        pid=os.getpid(),
        **vars(states.report(now_s)),
        tap=figures.Endpoint(*tap),
        device=figures.Endpoint(*device),
        muted=supervisor.config.muted,
        warnings=tuple(supervisor.warnings),
        device_rate=gathered(figures.DeviceRateFigures, rate) if rate else None,
        principal=tuple(
            figures.Partial(sound_hz, hz, level * size)
            for sound_hz, hz, size in (played if states.state is DaemonState.RUNNING else ())
        ),
        **values,
    )


def _of_python(engine: Engine, supervisor: Supervisor) -> dict[str, Any]:
    line, framework, drive = engine.delay_line.status, engine.framework, engine.drive
    levels = [driven.meter.level() for driven in engine.driven]
    return {
        "levels": figures.Levels(
            engine.sound.meter.level(),
            engine.vibration.meter.level(),
            tuple(level_of(*one) for one in engine.sound.meter.channel_readings()),
        ),
        "latency": figures.LatencyBudget.of(
            **parts_of_python(engine, *supervisor.latencies_s),
            offset_ms=1e3 * supervisor.alignment.offset_s,
            delay_ms=1e3 * max(drive.delays_frames, default=0) / engine.samplerate,
        ),
        "delay_line": gathered(figures.DelayLineFigures, line),
        "buffer_times": engine.buffer_times.times(),
        "effects_bypassed": tuple(framework.bypassed()),
        "engine": "python",
        "engine_reason": supervisor.engines.reason,
        **_of_rigs(drive.processors, levels, framework.settings, supervisor),
    }


def _of_native(native: NativeEngine, chain: Chain, supervisor: Supervisor) -> dict[str, Any]:
    settings, resting = supervisor.config.settings, supervisor.states.state is DaemonState.IDLE
    page = chain.page
    # While the daemon is idle, the plugin may be suspended, and its levels may be outdated.
    actuators = range(min(len(settings.actuators), len(chain.design.rigs)))
    levels = [Level() if resting else page.level(slot) for slot in actuators]
    channels = tuple(level_of(*reading) for reading in page.channel_readings())
    return {
        "levels": figures.Levels() if resting else figures.Levels(*page.levels, channels),
        "latency": figures.LatencyBudget.of(
            **parts_of_native(native, chain),
            offset_ms=1e3 * supervisor.alignment.offset_s,
            delay_ms=max((actuator.delay_ms for actuator in settings.actuators), default=0.0),
        ),
        "server": f"PipeWire {native.watch.graph.version}".rstrip(),
        "graph": gathered(
            figures.GraphFigures,
            page,
            tap="monitor" if native.monitor_reason else "streams",
            tap_reason=native.monitor_reason,
        ),
        "xruns": figures.Xruns(native.errors.count(".tap"), native.errors.count(".vibration")),
        "limited_samples": page.readings.limited,
        "replaced_samples": page.readings.replaced,
        "engine": "native",
        "engine_reason": "",
        **_of_rigs(chain.design.rigs, levels, settings, supervisor),
    }


def _of_rigs(
    rigs: Rigs, levels: Sequence[Level], settings: Settings, supervisor: Supervisor
) -> dict[str, Any]:
    since = supervisor.engines.safety.since
    protections = [
        gathered(figures.ProtectionFigures, rig.protection(), rig) if rig else None for rig in rigs
    ]
    exposures = [
        gathered(figures.ExposureFigures, rig.exposure(), rig, since=since) if rig else None
        for rig in rigs
    ]
    each = zip(settings.actuators, levels, protections, exposures, strict=False)
    return {
        "protection": min(
            filter(None, protections), key=lambda one: (one.gain, one.least_gain), default=None
        ),
        "exposure": worst_exposure([one for one in exposures if one]),
        "actuators": tuple(
            gathered(
                figures.ActuatorFigures,
                actuator,
                channels=tuple(map(str, actuator.channels)),
                rig=actuator.rig or settings.rig,
                level=level,
                protection=protection,
                exposure=exposure,
            )
            for actuator, level, protection, exposure in each
        ),
    }


def worst_exposure(found: Sequence[figures.ExposureFigures]) -> figures.ExposureFigures | None:
    """Return the largest values of all rigs, and the smallest `cap_gain`; None without rigs."""
    if not found:
        return None
    most = max(found, key=lambda one: one.a8_m_s2)
    capped = min(found, key=lambda one: one.cap_gain)
    names = ("time_s", "running_m_s2", "vdv", "above_action", "above_limit")
    worst = {name: max(getattr(one, name) for one in found) for name in names}
    return replace(most, **worst, cap=capped.cap, cap_gain=capped.cap_gain)


_IN_MEMORY = (
    b'{"frame": {"state": "%s", "level": %.4g, '
    b'"memory": {"name": "%s", "channels": %d, "actuators": %d}, "missed": %d}}\n'
)


def frame_of(
    supervisor: Supervisor, level: float, missed: int, *, in_memory: bool
) -> tuple[bytes, bool]:
    """Return a line `{"frame": ...}` of JSON, and whether the next line may be delayed.

    in_memory: whether the line may name the file of levels and partials instead of listing them.
    level: gain of the vibration, 0 while muted. missed: number of unsent lines. For any thread.
    """
    state = supervisor.states.state
    plays = state is DaemonState.RUNNING
    native, engine = supervisor.engines.native.engine, supervisor.engines.python
    playing = native.chain if native is not None and native.audible else None
    page = playing.page if playing is not None else None
    if page is None and in_memory and engine is not None and engine.live is not None:
        engine.live.watch()
        page = engine.live.page
    shown: Shown = ((0, 0, 0), ())
    if page is not None and in_memory:
        name, reader = page.path.name.encode(), page.reader
        counts = reader.channels, reader.actuators
        return _IN_MEMORY % (state.value.encode(), level, name, *counts, missed), True
    if page is not None and plays:
        shown = page.reader.shown()
    elif engine is not None and plays:
        channels = engine.sound.meter.channel_readings()
        actuators = [meter.reading() for meter in engine.driven_meters]
        partials = engine.framework.principal
        numbers = tuple(itertools.chain(*channels, *actuators, *partials))
        shown = (len(channels), len(actuators), len(partials)), numbers
    return _form(*shown[0]) % (state.value.encode(), level, *shown[1], missed), not plays


@cache
def _form(channels: int, actuators: int, partials: int) -> bytes:
    pairs, triples = "[%.4g, %.4g]", "[%.5g, %.5g, %.4g]"
    return (
        '{"frame": {"state": "%s", "level": %.4g, '
        f'"sound": [{", ".join([pairs] * channels)}], '
        f'"vibration": [{", ".join([pairs] * actuators)}], '
        f'"partials": [{", ".join([triples] * partials)}], '
        '"missed": %d}}\n'
    ).encode()
