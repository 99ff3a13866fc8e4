"""What a program must know that plays trials of fits and studies; see `trials/player.py`."""

from typing import Any

from audioflinger_hook.daemon.latency import parts_of_native
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.service.state import DaemonState


def trial_figures(supervisor: Supervisor) -> dict[str, Any]:
    """Return figures of trials as JSON. Any thread may call it.

    why: why the daemon plays no trials, or "". ready: whether a trial is felt if it plays now.
    lead_s: how much later the vibration than the sound begins in the stream. felt_s: how much later
    it is felt. seconds: of the signal. mean_squares: of the actuators. gain: of protection.
    """
    engines, native = supervisor.engines, supervisor.engines.native.engine
    state, chain = supervisor.states.report(0.0), native.chain if native else None
    why = ""
    if state.state not in (DaemonState.RUNNING, DaemonState.IDLE):
        why = f"{state.state.value}: {state.reason}" if state.reason else state.state.value
    elif supervisor.config.muted:
        why = "the vibration is muted; switch it on in the live page"
    elif engines.reason:
        why = f"trials need the native engine, which does not play: {engines.reason}"
    if native is None or chain is None:
        return {"why": why or "the daemon prepares trials", "ready": False}
    plan, page, rigs = chain.plan, chain.page, [rig for rig in chain.design.rigs if rig]
    own_s = 1e-3 * sum(parts_of_native(native, chain).values())
    transform_s = plan.transform.latency_frames / plan.samplerate
    lead_s, felt_s = supervisor.alignment.offset.of_trial(own_s, transform_s)
    actuators = page.readings.actuators[: len(plan.actuators)]
    return {
        "why": why,
        "ready": plan.is_trial and native.is_steady,
        "lead_s": lead_s,
        "felt_s": felt_s,
        "seconds": page.frames / plan.samplerate,
        "mean_squares": [one.level.mean_square for one in actuators],
        "gain": min((rig.protection().gain for rig in rigs), default=1.0),
    }
