"""The parts of the daemon's own latency, without the offset and without delays of actuators."""

from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.native.chain import Chain
from audioflinger_hook.daemon.native.engine import NativeEngine


def parts_of_python(engine: Engine, tap_s: float, output_s: float) -> dict[str, float]:
    """Return the parts in ms, named as in `LatencyBudget`. tap_s, output_s: of the streams."""
    line, framework = engine.delay_line.status, engine.framework
    return {
        "tap_ms": 1e3 * tap_s,
        "transform_ms": 1e3 * framework.latency_s,
        "delay_line_ms": 1e3 * (line.target_s - line.offset_s),
        "output_ms": 1e3 * output_s,
        "driving_ms": 1e3 * engine.drive.latency_frames / engine.samplerate,
    }


def parts_of_native(native: NativeEngine, chain: Chain) -> dict[str, float]:
    """Return the parts in ms, named as in `LatencyBudget`.

    Tap and device run in the same cycle of the graph, so they have no delay line.
    """
    plan, page = chain.plan, chain.page
    latency_frames = max((rig.latency_frames for rig in chain.design.rigs if rig), default=0)
    transform_frames = 0 if plan.is_trial else plan.transform.latency_frames
    # If the sink drives the graph, its monitor provides sound one cycle late.
    is_late = native.monitor_reason and page.samplerate and not plan.is_trial
    return {
        "tap_ms": 1e3 * page.cycle_frames / page.samplerate if is_late else 0.0,
        "transform_ms": 1e3 * transform_frames / plan.samplerate,
        "driving_ms": 1e3 * latency_frames / plan.samplerate,
    }
