"""The offset: which source wins, which changes it follows, what drop-in mode delays; its store."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.daemon import offset
from audioflinger_hook.daemon.offset_store import DAMAGED, FILE, PAIRS_MAX, OffsetStore, SinkPair
from device.errors import CushionError, UsageError
from device.server.forwarding import MAX_DELAY_S, MIN_DELAY_S
from tests.support.run_configs import config

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


def test_drop_in_mode_delays_the_vibration_where_the_sound_is_later(tmp_path):
    case = Case(tmp_path, drop_in=True)
    case.update(BLUETOOTH)
    assert (case.offset.sound_s, case.early_s) == (MIN_DELAY_S, pytest.approx(OWN_S - 0.2))
    case.update(own_s=3.0)
    assert case.offset.sound_s == MAX_DELAY_S


def test_drop_in_modes_delay_contains_the_one_of_the_sink_on_pulseaudio(tmp_path):
    case = Case(tmp_path, drop_in=True)
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
    store = OffsetStore(tmp_path / "new" / "folder")
    for pair, delay_s in ((OTHER, 0.1), (PAIR, 0.2), (OTHER, -0.05)):
        store.store(pair, delay_s)
    again = OffsetStore(tmp_path / "new" / "folder")
    assert (again.delay_s(OTHER), again.delay_s(PAIR), again.warning) == (-0.05, 0.2, "")
    assert again.delay_s(OTHER._replace(felt="other")) is None
    assert len(json.loads((tmp_path / "new" / "folder" / FILE).read_text())["offsets"]) == 2


def test_the_oldest_pairs_are_dropped_when_there_are_too_many(tmp_path):
    store = OffsetStore(tmp_path)
    known = [{"heard": str(one), "felt": "f", "delay_s": 0.1} for one in range(PAIRS_MAX)]
    (tmp_path / FILE).write_text(json.dumps({"version": 1, "offsets": known}))
    store = OffsetStore(tmp_path)
    store.store(OTHER, 0.1)
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
