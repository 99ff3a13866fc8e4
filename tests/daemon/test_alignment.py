"""Which sinks the offset is about, when their delays are read, and what PulseAudio's mean."""

import random
from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import numpy as np
import pytest

from audioflinger_hook.daemon.alignment import Alignment
from audioflinger_hook.daemon.declared import ORDINARY_S, DeclaredDelays
from audioflinger_hook.daemon.inputs.applications import Applications
from audioflinger_hook.daemon.offset import DECLARED, FOLLOWED_S, UNKNOWN
from audioflinger_hook.daemon.offset_store import OffsetStore, SinkPair
from audioflinger_hook.daemon.supervisor import TICKS_S
from device.clock.delay_control import DelayState, DelayStatus
from tests.support.run_configs import config
from tests.support.snapshots import monitor, sink, snapshot, source, stream

SPEAKERS, HEADPHONES, CUSHION = (sink(n, name) for n, name in enumerate(("tv", "bt", "cushion")))
OWN_S = 0.07


class Case:
    """An alignment on PulseAudio with the Python engine, and what it was told and has done."""

    def __init__(self, store: OffsetStore | None = None, **live: Any) -> None:
        latencies = {"framework.latency_s": 0.0, "drive.latency_frames": 0}
        self.python = Mock(samplerate=48_000, **latencies)
        self.python.delay_line.status = DelayStatus(OWN_S, state=DelayState.LOCKED)
        engines = Mock(python=self.python, **{"native.engine": None})
        drop_in = SimpleNamespace(target_name="tv", set_delay=lambda _: None)
        self.latencies_s, self.queries = {"tv": 0.0, "bt": 0.2, "cushion": 0.0}, 0
        self.connection = SimpleNamespace(latest=snapshot("PulseAudio"), latencies_s=self._query)
        known, told = store or OffsetStore(), config(**live)
        self.made = Alignment(told, engines, cast(Any, drop_in), known, lambda: None)
        self.now_s, self.tick_s = 0.0, 0.093

    def _query(self) -> dict[str, float]:
        self.queries += 1
        return self.latencies_s

    def pass_s(self, seconds: float, heard: Any = None, *, runs: bool = True) -> tuple[float, str]:
        """Offset and reason after ticks for this time; heard: what the input has located."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.now_s += self.tick_s
            places = heard or monitor(HEADPHONES), CUSHION, (0.0, 0.0)
            self.made.maintain(cast(Any, self.connection), *places, self.now_s, runs=runs)
        return self.made.offset.vibration_s, self.made.offset.reason


def test_a_sinks_latency_less_both_the_devices_and_ours_is_the_offset():
    case = Case()
    case.latencies_s["cushion"] = 0.02
    offset_s, reason = case.pass_s(1.0)
    assert offset_s == pytest.approx(0.2 - 0.02 - OWN_S)
    assert reason == DECLARED


@pytest.mark.parametrize(("beyond_s", "reason"), [(-0.001, UNKNOWN), (0.001, DECLARED)])
def test_a_usual_buffer_is_no_declared_delay(beyond_s, reason):
    case = Case()
    case.latencies_s |= {"bt": 0.03 + ORDINARY_S + beyond_s, "cushion": 0.03}
    assert case.pass_s(1.0) == (0.0, reason)


def test_another_latency_is_followed_within_3_s_and_asked_for_once_a_tick():
    case = Case()
    case.pass_s(10.0)
    case.latencies_s["bt"] = 0.09
    offset_s, _ = case.pass_s(3.0)
    assert offset_s == pytest.approx(0.09 - OWN_S)
    assert case.queries <= 13.0 / case.tick_s + 2


@pytest.mark.parametrize("block_ms", [25.0, 37.9, 46.5, 93.0])
def test_queries_do_not_keep_step_with_a_sinks_buffer(block_ms):
    case, chance = Case(), random.Random(1)
    found_s = []
    for _ in range(400):
        case.tick_s = chance.uniform(*TICKS_S)
        case.latencies_s["bt"] = 0.2 - 1e-3 * block_ms + (-case.now_s) % (1e-3 * block_ms)
        found_s.append(case.pass_s(0.05)[0])
    settled_s = np.array(found_s[60:]) + OWN_S - 0.2
    assert np.abs(settled_s + 1e-3 * block_ms / 3).max() < 1e-3 * block_ms / 6 + FOLLOWED_S


def test_the_offset_stands_still_while_a_buffer_empties_and_fills():
    case, found_s = Case(), []
    for tick in range(400):
        case.latencies_s["bt"] = 0.15 + 0.05 * (1.0 - (tick * 0.093 / 0.05) % 1.0)
        offset_s, _ = case.pass_s(0.05)
        found_s.append(offset_s)
    steady_s = found_s[50:]
    assert max(steady_s) - min(steady_s) <= 2.5 * FOLLOWED_S
    assert max(steady_s) == pytest.approx(0.19 - OWN_S, abs=0.01)
    assert sum(one != other for one, other in pairwise(steady_s)) <= len(steady_s) // 25


def test_an_idle_sink_that_declares_nothing_changes_nothing():
    case = Case()
    before = case.pass_s(1.0)
    case.latencies_s["bt"] = 0.0
    assert case.pass_s(60.0, runs=False) == before


def test_the_delay_of_another_sink_is_forgotten_before_the_next_one_plays():
    case = Case()
    case.pass_s(1.0)
    case.python.delay_line.status = DelayStatus(OWN_S)  # nothing plays
    case.pass_s(0.2, monitor(SPEAKERS))
    case.python.delay_line.status = DelayStatus(OWN_S, state=DelayState.LOCKED)
    assert (case.pass_s(0.2, monitor(SPEAKERS)), case.pass_s(0.2)[1]) == ((0.0, UNKNOWN), DECLARED)


def test_applications_are_heard_where_they_all_play_and_a_microphone_nowhere():
    case = Case()
    both = stream(1, 0, "tv"), stream(2, 1, "bt")
    assert case.pass_s(1.0, Applications(both[1:]))[1] == DECLARED
    assert case.pass_s(1.0, Applications())[1] == DECLARED  # between two songs
    assert case.pass_s(1.0, Applications((replace(both[0], corked=True), both[1])))[1] == DECLARED
    assert case.pass_s(1.0, Applications(both)) == (0.0, UNKNOWN)
    assert case.pass_s(1.0, Applications(both, sink="bt"))[1] == DECLARED
    assert Case().pass_s(1.0, source(9, "microphone")) == (0.0, UNKNOWN)


def test_one_watch_of_the_graph_is_enough():
    declared, closed = DeclaredDelays(lambda: None), []
    declared._watch = cast(Any, SimpleNamespace(close=lambda: closed.append(True)))
    graph = SimpleNamespace(declared_s=lambda *_: 0.1)
    watch = cast(Any, SimpleNamespace(lock=nullcontext(), graph=graph))
    connection = cast(Any, SimpleNamespace(latest=snapshot("PipeWire")))
    pair = SinkPair("tv", "dac")
    found = declared.read(pair, connection, watch, (1_024, 48_000), 0.0, forwards=False)
    assert (found.heard_s, closed) == (0.1, [True])


def test_drop_in_mode_hears_the_sink_that_it_forwards_to(tmp_path):
    store = OffsetStore(tmp_path)
    store.store(SinkPair("tv", "cushion"), 0.3)
    case = Case(store, drop_in=True)
    offset_s, _ = case.pass_s(1.0)
    assert offset_s - case.made.offset.sound_s == pytest.approx(0.3 - OWN_S)


def test_with_a_number_nobody_asks_the_server_and_without_one_an_impossible_delay_is_told():
    case = Case(offset_ms=40)
    assert (case.pass_s(10.0)[0], case.queries) == (0.04, 0)
    case = Case()
    case.latencies_s["bt"] = 5.0
    assert case.pass_s(1.0) == (0.0, UNKNOWN)
    (line,) = case.made.warnings
    assert "'bt' declares a delay of 5000 ms, which is ignored; allowed: 0 to 2000 ms" in line
