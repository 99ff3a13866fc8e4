import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import pytest

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon import engines as engines_module
from audioflinger_hook.daemon.engine import Clocks
from audioflinger_hook.daemon.engines import Engines
from audioflinger_hook.daemon.inputs.applications import Applications
from audioflinger_hook.daemon.native import chains as chains_module
from audioflinger_hook.daemon.native.chains import RESTART_S, STUCK_S, Chains, RunningChain
from audioflinger_hook.daemon.native.plan import ChainPlan, DriveDesigns
from audioflinger_hook.daemon.native.run import FAILURES_MAX, START_S, NativeRun
from audioflinger_hook.daemon.native.taps import Tap
from audioflinger_hook.daemon.outputs.base import DeviceVolume
from audioflinger_hook.daemon.run_config import RunConfig, changes_between
from audioflinger_hook.daemon.safety_keeper import SafetyKeeper
from audioflinger_hook.service.state import DaemonState, StateKeeper
from device.errors import LostError
from device.server import PulseConnection
from device.server.graph import Graph
from device.server.snapshot import Sink, Source
from tests.support.run_configs import config

SINK = Sink(1, "dac", "DAC", "dac.monitor", 48_000, 2, None, {}, "front-left,front-right")
SOURCE = Source(2, "desk.monitor", "Desk", "desk", 48_000, 2, {}, "front-left,front-right")
CONFIG = config()
PLAN = ChainPlan.of(Settings(), Tap("desk", ("FL", "FR"), "desk"), 48_000)


def native(error: LostError | None = None) -> Any:
    """Stands in for the native engine, which needs a server; only its answers count here."""
    one = Mock(monitor_reason="", waits_for="", is_fed=True)
    one.watch.lost = one.designs.is_busy = False
    one.unseen.return_value, one.maintain.return_value = "", False
    one.maintain.side_effect = error
    one.use_monitor.side_effect = lambda reason: setattr(one, "monitor_reason", reason)
    return one


def kept(engine, folder, times_s, source=SOURCE, players=frozenset()):
    run = NativeRun(CONFIG, folder, StateKeeper(0.0), lambda: None, lambda *_: None)
    server = cast(PulseConnection, SimpleNamespace(set_sink_volume_db=lambda *_: None))
    for now_s in times_s:
        run.engine = run.engine or engine
        run.maintain(source, SINK, players, server, DeviceVolume(None), (1.0, 1.0), now_s)
        yield run


def test_after_some_failures_python_computes_and_the_reason_is_said(tmp_path):
    engine = native(LostError("it crashed"))
    times_s = [0.1 * count for count in range(FAILURES_MAX)]
    problems = [run.problem for run in kept(engine, tmp_path, times_s)]
    assert problems == [""] * (FAILURES_MAX - 1) + ["the native engine failed: it crashed"]
    assert engine.monitor_reason == "the native engine failed: it crashed"


def test_a_start_that_takes_too_long_leads_to_the_monitor_then_to_python(tmp_path):
    engine = native()
    times_s = [0.0, START_S - 0.1, START_S + 0.1, 2.0 * START_S, 2.0 * START_S + 0.3]
    ways, reason = [], ""
    for run in kept(engine, tmp_path, times_s):
        ways.append((not run.problem, bool(engine.monitor_reason)))
        reason = run.problem
    assert ways == [(True, False), (True, False), (True, True), (True, True), (False, True)]
    assert "did not start within 5 s" in reason


def test_chosen_applications_are_never_tapped_by_the_monitor_which_has_all_sound(tmp_path):
    late, lost = native(), native(LostError("it crashed"))
    for engine, times_s in ((late, [0.0, START_S + 0.1]), (lost, [0.0, 0.1])):
        (*_, run) = kept(engine, tmp_path, times_s, Applications(()))
        assert run.problem
        assert not engine.monitor_reason


@pytest.mark.parametrize(
    ("reason", "is_fed", "state"),
    [
        ("", False, DaemonState.IDLE),
        ("", True, DaemonState.RUNNING),
        ("refused", False, DaemonState.RUNNING),
    ],
)
def test_streams_that_are_left_out_let_the_daemon_rest(tmp_path, reason, is_fed, state):
    engine = native()
    engine.maintain.return_value, engine.is_fed, engine.monitor_reason = True, is_fed, reason
    (*_, run) = kept(engine, tmp_path, [0.0, 100.0], players=frozenset({9}))
    assert run._states.state is state


def test_a_chain_that_failed_once_begins_anew_with_the_streams(tmp_path):
    engine = native()
    for run in kept(engine, tmp_path, [0.0, 0.9 * START_S, START_S + 0.1, START_S + 0.2]):
        lost = LostError("it did not appear") if run._began_s == 0.0 else None
        engine.maintain.side_effect = lost
    assert not engine.monitor_reason


def test_the_engine_is_chosen_when_a_server_or_a_config_begins_only(tmp_path, monkeypatch):
    endpoints: Any = SimpleNamespace(needs_server=True)
    clocks, states = Clocks(float, float), StateKeeper(0.0)
    engines = Engines(CONFIG, clocks, endpoints, states, tmp_path, lambda: None, SafetyKeeper())
    monkeypatch.setattr(engines_module, "why_python", lambda *_: "")
    first, second = (cast(PulseConnection, SimpleNamespace(latest=None, name=n)) for n in "ab")

    def chosen(connection: PulseConnection) -> str:
        engines._choose(connection, SOURCE)
        return engines.reason

    def follow(wanted: RunConfig) -> None:
        engines.follow(wanted, changes_between(CONFIG, wanted))

    assert chosen(first) == ""
    engines.reason = "the native engine failed"
    follow(CONFIG)
    follow(replace(CONFIG, muted=True, settings=Settings(gain_db=-6.0)))
    follow(replace(CONFIG, settings=Settings(profile="music")))
    assert (chosen(first), chosen(second)) == ("the native engine failed", "")
    engines.reason = "the native engine failed"
    follow(replace(CONFIG, settings=Settings(damping="auto")))
    assert chosen(second) == ""
    engines._choose(second, replace(SOURCE, channels=10))
    assert (engines.reason, chosen(second)) == ("the tap has 10 channels, more than 8", "")


@pytest.fixture
def chains(tmp_path):
    return Chains(CONFIG, tmp_path, lambda *_: None, DriveDesigns())


def chain(**changes: Any) -> RunningChain:
    one = Mock(**{"plan": PLAN, "is_stopped": False, "complaint": "the design is cut"} | changes)
    one.page.frames = one.page.samplerate = 48_000
    one.page.faded_out.return_value = False
    one.last_words = lambda: f": {one.complaint}"
    return RunningChain(cast(Any, one), 0.0, linked_s=0.0)


def test_a_chain_that_was_stopped_is_ended_and_lost(chains):
    chains.current = stopped = chain(is_stopped=True)
    with pytest.raises(LostError, match="was stopped"):
        chains.check(Graph(), 1.0, is_fed=True)
    assert chains.current is None
    assert cast(Any, stopped.chain).close.called


def waiting() -> RunningChain:
    """A chain that began at 0 s, and that PipeWire leaves waiting."""
    one = chain(is_in=lambda _: False)
    one.linked_s = math.inf
    return one


def test_a_process_that_pipewire_leaves_waiting_is_ended_once_without_a_word(chains):
    chains.following = first = waiting()
    chains.check(Graph(), 0.9 * RESTART_S, is_fed=False)
    assert chains.following is first
    chains.check(Graph(), 1.1 * RESTART_S, is_fed=False)
    assert chains.following is None
    assert cast(Any, first.chain).close.called
    chains.following = second = waiting()
    chains.check(Graph(), 2.0 * RESTART_S, is_fed=False)
    assert chains.following is second
    with pytest.raises(LostError, match="did not appear in PipeWire's graph"):
        chains.check(Graph(), 1.1 * chains_module.START_S, is_fed=False)
    assert chains.following is None


@pytest.mark.parametrize("is_fed", [True, False])
def test_a_chain_that_processes_nothing_is_replaced_if_something_plays(chains, is_fed, monkeypatch):
    begun: list[ChainPlan] = []
    monkeypatch.setattr(chains, "_begin", lambda plan, now_s: begun.append(plan))
    chains.current = chain()
    for now_s in (0.0, 0.9 * STUCK_S, 1.1 * STUCK_S, 2.2 * STUCK_S):
        chains.check(Graph(), now_s, is_fed=is_fed)
        chains.make(PLAN, now_s)
        if now_s < STUCK_S:
            assert not begun
    assert bool(begun) == is_fed


@pytest.mark.parametrize("place", ["following", "current"])
def test_a_chain_that_never_processed_anything_is_lost_with_its_last_words(chains, place):
    setattr(chains, place, one := chain())
    one.chain.page.frames = 0  # type: ignore[misc]
    chains.check(Graph(), 0.0, is_fed=True)
    with pytest.raises(LostError, match="nothing although sound plays: the design is cut"):
        chains.check(Graph(), 1.1 * STUCK_S, is_fed=True)
    assert getattr(chains, place) is None


def test_a_chain_that_begins_late_and_does_not_complain_is_not_lost(chains):
    chains.current = slow = chain()
    slow.chain.page.frames, slow.chain.complaint = 0, ""  # type: ignore[misc]
    for now_s in (0.0, 1.1 * STUCK_S):
        chains.check(Graph(), now_s, is_fed=True)
    assert chains.current is slow
