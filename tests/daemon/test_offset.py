import json
import random
from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.daemon import offset
from audioflinger_hook.daemon.alignment import Alignment
from audioflinger_hook.daemon.declared import ORDINARY_S, DeclaredDelays
from audioflinger_hook.daemon.inputs.applications import Applications
from audioflinger_hook.daemon.offset import DECLARED, FOLLOWED_S, UNKNOWN
from audioflinger_hook.daemon.offset_store import DAMAGED, FILE, PAIRS_MAX, OffsetStore, SinkPair
from audioflinger_hook.daemon.supervisor import TICKS_S
from device.clock.delay_control import DelayState, DelayStatus
from device.errors import CushionError, UsageError
from device.server.forwarding import MAX_DELAY_S, MIN_DELAY_S
from tests.support.run_configs import config
from tests.support.snapshots import monitor, sink, snapshot, source, stream

PAIR, OTHER = SinkPair("speakers", "cushion"), SinkPair("headphones", "cushion")
OWN_S = 0.009
NOTHING = offset.Declared()
BLUETOOTH = offset.Declared(0.2, 0.0, is_known=True)


class Case:
    """An offset with a store, told of one pair of sinks; time passes by `update`."""

    def __init__(self, folder, **live):
        self.offset, self.now_s = offset.Offset(config(**live), OffsetStore(folder)), 0.0

    def update(self, declared=NOTHING, *, pair=PAIR, own_s=OWN_S, after_s=0.25):
        self.now_s += after_s
        self.offset.update(pair, declared, own_s, self.now_s)
        return self.offset.vibration_s

    @property
    def early_s(self):
        """Time from the vibration to its sound, without what sinks and daemon add."""
        return self.offset.sound_s - self.offset.vibration_s


@pytest.fixture
def case(tmp_path):
    return Case(tmp_path)


def test_it_is_never_below_0_without_drop_in_mode_nor_more_than_the_engines_can_delay(case):
    assert case.update(offset.Declared(0.0, 0.3, is_known=True)) == 0.0
    assert (case.update(BLUETOOTH, own_s=0.25), case.offset.sound_s) == (0.0, 0.0)
    longest = offset.Declared(offset.LONGEST_S, 0.0, is_known=True)
    assert case.update(longest, own_s=-0.1) == offset.LONGEST_S


def test_only_changes_of_more_than_5_ms_are_followed(case):
    first_s = case.update(BLUETOOTH)
    hardly_later = offset.Declared(0.2 + 0.99 * offset.FOLLOWED_S, 0.0, is_known=True)
    assert case.update(hardly_later) == first_s
    assert case.update(BLUETOOTH, own_s=OWN_S - 0.99 * offset.FOLLOWED_S) == first_s
    assert case.update(BLUETOOTH, own_s=None) == first_s  # no engine plays
    assert case.update(offset.Declared(0.08, 0.0, is_known=True)) == pytest.approx(0.08 - OWN_S)
    assert case.update(BLUETOOTH, pair=OTHER) == pytest.approx(0.2 - OWN_S)


def test_slow_changes_are_followed_before_they_add_up(case):
    errors_s = []
    for step in range(100):
        heard_s = 0.1 + 0.001 * step
        found_s = case.update(offset.Declared(heard_s, 0.0, is_known=True))
        errors_s.append(abs(found_s - (heard_s - OWN_S)))
    assert max(errors_s) <= offset.FOLLOWED_S + 1e-9


def test_a_stored_delay_ends_the_trial_and_wins_over_a_declared_one_for_its_pair_only(tmp_path):
    case = Case(tmp_path)
    case.update(BLUETOOTH)
    case.offset.try_out(0.3)
    case.offset.store(0.12)
    assert case.offset.vibration_s == pytest.approx(0.12)
    assert case.offset.reason == offset.MEASURED
    assert case.update(BLUETOOTH, pair=OTHER) == pytest.approx(0.2 - OWN_S)
    assert case.offset.reason == offset.DECLARED
    again = Case(tmp_path)
    assert (again.update(BLUETOOTH), again.offset.reason) == (pytest.approx(0.12), offset.MEASURED)
    slower_s = OWN_S + 0.06  # as with the Python engine
    assert again.update(own_s=slower_s) == pytest.approx(0.06)


def test_a_number_in_the_config_wins_over_everything_but_a_trial(tmp_path):
    case = Case(tmp_path, offset_ms=30)
    assert case.update(BLUETOOTH) == 0.03
    case.offset.store(0.12)
    assert (case.update(BLUETOOTH), case.offset.reason) == (0.03, offset.SET)
    case.offset.try_out(0.25)
    assert case.offset.vibration_s == 0.25
    case.offset.try_out(None)
    assert case.offset.vibration_s == 0.03
    case.offset.follow(config())
    assert case.offset.vibration_s == pytest.approx(0.12)
    assert case.offset.reason == offset.MEASURED


def test_a_trial_that_nobody_ends_ends_by_itself(case):
    case.offset.try_out(0.3)
    assert (case.update(after_s=5.0), case.update(after_s=offset.TRIAL_S - 1.0)) == (0.3, 0.3)
    assert case.update(after_s=2.0) == 0.0


@pytest.mark.parametrize("missing", [{"pair": None}, {"own_s": None}])
def test_nothing_can_be_stored_without_two_sinks_and_a_playing_engine(case, missing):
    case.update(**missing)
    with pytest.raises(UsageError, match="it needs a sound that plays"):
        case.offset.store(0.1)


def test_drop_in_mode_delays_the_sound_instead_and_rarely_changes_its_delay(tmp_path):
    case, sounds_s = Case(tmp_path, drop_in=True), set()
    for own_s in (0.07, 0.076, 0.064, 0.079, 0.05, 0.07):
        case.update(own_s=own_s)
        sounds_s.add(case.offset.sound_s)
        assert case.early_s == pytest.approx(own_s, abs=offset.FOLLOWED_S)
    (sound_s,) = sounds_s
    assert 0.07 <= sound_s <= 0.07 + offset.SPARE_MAX_S
    case.update(own_s=0.2)
    assert case.early_s == pytest.approx(0.2)


def test_drop_in_mode_delays_the_vibration_where_the_sound_is_later_and_counts_its_sink(tmp_path):
    case = Case(tmp_path, drop_in=True)
    case.update(BLUETOOTH)
    assert (case.offset.sound_s, case.early_s) == (MIN_DELAY_S, pytest.approx(OWN_S - 0.2))
    case.update(own_s=3.0)
    assert case.offset.sound_s == MAX_DELAY_S
    case = Case(tmp_path, drop_in=True)  # on PulseAudio
    case.update(offset.Declared(0.03, 0.03, forwarded_s=0.03), own_s=0.07)
    # heard `sound_s` after its capture, felt after own latency, offset and the device's delay
    assert case.offset.sound_s == pytest.approx(0.07 + case.offset.vibration_s + 0.03)


@pytest.mark.parametrize("offset_s", [-0.06, 0.0, 0.1])
def test_drop_in_mode_stores_what_was_tried(tmp_path, offset_s):
    case = Case(tmp_path, drop_in=True)
    case.update(own_s=0.07)
    case.offset.try_out(offset_s)
    tried_s = max(MIN_DELAY_S, case.offset.sound_s) - case.offset.vibration_s
    case.offset.store(offset_s)
    assert case.early_s == pytest.approx(tried_s)


def test_the_latest_delay_of_a_pair_is_found_again_for_exactly_this_pair(tmp_path):
    folder = tmp_path / "new" / "folder"
    store = OffsetStore(folder)
    for pair, delay_s in ((OTHER, 0.1), (PAIR, 0.2), (OTHER, -0.05)):
        store.store(pair, delay_s)
    again = OffsetStore(folder)
    assert (again.delay_s(OTHER), again.delay_s(PAIR), again.warning) == (-0.05, 0.2, "")
    assert again.delay_s(OTHER._replace(felt="other")) is None
    assert len(json.loads((folder / FILE).read_text())["offsets"]) == 2


def test_the_oldest_pairs_are_dropped_when_there_are_too_many(tmp_path):
    known = [{"heard": str(one), "felt": "f", "delay_s": 0.1} for one in range(PAIRS_MAX)]
    (tmp_path / FILE).write_text(json.dumps({"version": 1, "offsets": known}))
    OffsetStore(tmp_path).store(OTHER, 0.1)
    again = OffsetStore(tmp_path)
    assert again.delay_s(SinkPair("0", "f")) is None
    assert again.delay_s(SinkPair("1", "f")) == again.delay_s(OTHER) == 0.1


ONE = {"heard": "a", "felt": "b", "delay_s": 0.1}
WRONG: list[object] = [{**ONE, "delay_s": wrong} for wrong in (1e9, -11, "1", None, [0.1], True)]
WRONG += [{**ONE, "heard": 5}, {"heard": "a", "felt": "b"}, 3, None]


@pytest.mark.parametrize(
    "content",
    [
        *(json.dumps({"version": 1, "offsets": [one]}) for one in WRONG),
        *('{"version": 1', "", "[]", "null", "\0", '{"version": 2, "offsets": []}', "[" * 9_000),
        '{"version": 1, "offsets": [{"heard": "a", "felt": "b", "delay_s": NaN}]}',
        '{"version": 1, "offsets": 5}',
    ],
)
def test_a_damaged_file_is_set_aside_with_a_warning_and_a_new_one_works(tmp_path, content):
    (tmp_path / FILE).write_text(content)
    store = OffsetStore(tmp_path)
    assert store.delay_s(OTHER) is None
    assert "damaged" in store.warning
    assert "cushion sync" in store.warning
    assert (tmp_path / DAMAGED).read_text() == content
    store.store(OTHER, 0.1)
    assert (store.warning, OffsetStore(tmp_path).delay_s(OTHER)) == ("", 0.1)


@given(st.binary(max_size=200))
def test_no_content_of_the_file_stops_the_daemon(tmp_path_factory, content):
    folder = tmp_path_factory.mktemp("state")
    (folder / FILE).write_bytes(content)
    OffsetStore(folder)


def test_a_file_that_cannot_be_read_is_left_alone_and_without_a_folder_a_delay_lasts(tmp_path):
    (tmp_path / FILE).mkdir()
    assert "cannot be read" in OffsetStore(tmp_path).warning
    assert (tmp_path / FILE).is_dir()
    store = OffsetStore()
    with pytest.raises(UsageError, match="XDG_STATE_HOME"):
        store.store(OTHER, 0.1)
    assert store.delay_s(OTHER) == 0.1


def test_a_full_disk_keeps_the_old_file_and_the_new_delay_until_the_end(small_disk):
    store = OffsetStore(small_disk)
    store.store(OTHER, 0.1)
    (small_disk / "filler").write_bytes(b"\0" * 24_000)
    store._delays_s |= {SinkPair(f"sink {one}", "f" * 90): 0.1 for one in range(100)}
    with pytest.raises(CushionError, match="disk is full"):
        store.store(PAIR, 0.2)
    assert (store.delay_s(PAIR), OffsetStore(small_disk).delay_s(OTHER)) == (0.2, 0.1)


SPEAKERS, HEADPHONES, CUSHION = (sink(n, name) for n, name in enumerate(("tv", "bt", "cushion")))
PYTHON_S = 0.07


class Aligned:
    """An alignment on PulseAudio with the Python engine, and what it was told and has done."""

    def __init__(self, store: OffsetStore | None = None, **live: Any) -> None:
        latencies = {"framework.latency_s": 0.0, "drive.latency_frames": 0}
        self.python = Mock(samplerate=48_000, **latencies)
        self.python.delay_line.status = DelayStatus(PYTHON_S, state=DelayState.LOCKED)
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


def test_a_sinks_latency_less_the_devices_and_ours_is_the_offset_also_while_it_idles():
    case = Aligned()
    case.latencies_s["cushion"] = 0.02
    found: Any = case.pass_s(1.0)
    assert found == (pytest.approx(0.2 - 0.02 - PYTHON_S), DECLARED)
    case.latencies_s["bt"] = 0.0  # an idle sink declares nothing
    assert case.pass_s(60.0, runs=False) == found


@pytest.mark.parametrize(("beyond_s", "reason"), [(-0.001, UNKNOWN), (0.001, DECLARED)])
def test_a_usual_buffer_is_no_declared_delay(beyond_s, reason):
    case = Aligned()
    case.latencies_s |= {"bt": 0.03 + ORDINARY_S + beyond_s, "cushion": 0.03}
    assert case.pass_s(1.0) == (0.0, reason)


def test_another_latency_is_followed_within_3_s_and_asked_for_once_a_tick():
    case = Aligned()
    case.pass_s(10.0)
    case.latencies_s["bt"] = 0.09
    offset_s, _ = case.pass_s(3.0)
    assert offset_s == pytest.approx(0.09 - PYTHON_S)
    assert case.queries <= 13.0 / case.tick_s + 2


@pytest.mark.parametrize("block_ms", [25.0, 37.9, 46.5, 93.0])
def test_queries_do_not_keep_step_with_a_sinks_buffer(block_ms):
    case, chance = Aligned(), random.Random(1)
    found_s = []
    for _ in range(400):
        case.tick_s = chance.uniform(*TICKS_S)
        case.latencies_s["bt"] = 0.2 - 1e-3 * block_ms + (-case.now_s) % (1e-3 * block_ms)
        found_s.append(case.pass_s(0.05)[0])
    settled_s = np.array(found_s[60:]) + PYTHON_S - 0.2
    assert np.abs(settled_s + 1e-3 * block_ms / 3).max() < 1e-3 * block_ms / 6 + FOLLOWED_S


def test_the_offset_stands_still_while_a_buffer_empties_and_fills():
    case, found_s = Aligned(), []
    for tick in range(400):
        case.latencies_s["bt"] = 0.15 + 0.05 * (1.0 - (tick * 0.093 / 0.05) % 1.0)
        offset_s, _ = case.pass_s(0.05)
        found_s.append(offset_s)
    steady_s = found_s[50:]
    assert max(steady_s) - min(steady_s) <= 2.5 * FOLLOWED_S
    assert max(steady_s) == pytest.approx(0.19 - PYTHON_S, abs=0.01)
    assert sum(one != other for one, other in pairwise(steady_s)) <= len(steady_s) // 25


def test_the_delay_of_another_sink_is_forgotten_before_the_next_one_plays():
    case = Aligned()
    case.pass_s(1.0)
    case.python.delay_line.status = DelayStatus(PYTHON_S)  # nothing plays
    case.pass_s(0.2, monitor(SPEAKERS))
    case.python.delay_line.status = DelayStatus(PYTHON_S, state=DelayState.LOCKED)
    assert (case.pass_s(0.2, monitor(SPEAKERS)), case.pass_s(0.2)[1]) == ((0.0, UNKNOWN), DECLARED)


def test_applications_are_heard_where_they_all_play_and_a_microphone_nowhere():
    case = Aligned()
    both = stream(1, 0, "tv"), stream(2, 1, "bt")
    assert case.pass_s(1.0, Applications(both[1:]))[1] == DECLARED
    assert case.pass_s(1.0, Applications())[1] == DECLARED  # between two songs
    assert case.pass_s(1.0, Applications((replace(both[0], corked=True), both[1])))[1] == DECLARED
    assert case.pass_s(1.0, Applications(both)) == (0.0, UNKNOWN)
    assert case.pass_s(1.0, Applications(both, sink="bt"))[1] == DECLARED
    assert Aligned().pass_s(1.0, source(9, "microphone")) == (0.0, UNKNOWN)


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
    case = Aligned(store, drop_in=True)
    offset_s, _ = case.pass_s(1.0)
    assert offset_s - case.made.offset.sound_s == pytest.approx(0.3 - PYTHON_S)


def test_with_a_number_nobody_asks_the_server_and_without_one_an_impossible_delay_is_told():
    case = Aligned(offset_ms=40)
    assert (case.pass_s(10.0)[0], case.queries) == (0.04, 0)
    case = Aligned()
    case.latencies_s["bt"] = 5.0
    assert case.pass_s(1.0) == (0.0, UNKNOWN)
    (line,) = case.made.warnings
    assert "'bt' declares a delay of 5000 ms, which is ignored; allowed: 0 to 2000 ms" in line
