"""Stored delays: one for each pair of sinks, whatever happens to the file."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.daemon.offset_store import DAMAGED, FILE, PAIRS_MAX, OffsetStore, SinkPair
from device.errors import CushionError, UsageError

HEADPHONES, SPEAKERS = SinkPair("bluez.1", "cushion"), SinkPair("alsa.1", "cushion")


def test_the_latest_delay_of_a_pair_is_found_again_for_exactly_this_pair(tmp_path):
    store = OffsetStore(tmp_path / "new" / "folder")
    for pair, delay_s in ((HEADPHONES, 0.1), (SPEAKERS, 0.2), (HEADPHONES, -0.05)):
        store.store(pair, delay_s)
    again = OffsetStore(tmp_path / "new" / "folder")
    assert (again.delay_s(HEADPHONES), again.delay_s(SPEAKERS), again.warning) == (-0.05, 0.2, "")
    assert again.delay_s(HEADPHONES._replace(felt="other")) is None
    assert len(json.loads((tmp_path / "new" / "folder" / FILE).read_text())["offsets"]) == 2


def test_the_oldest_pairs_are_dropped_when_there_are_too_many(tmp_path):
    store = OffsetStore(tmp_path)
    known = [{"heard": str(one), "felt": "f", "delay_s": 0.1} for one in range(PAIRS_MAX)]
    (tmp_path / FILE).write_text(json.dumps({"version": 1, "offsets": known}))
    store = OffsetStore(tmp_path)
    store.store(HEADPHONES, 0.1)
    again = OffsetStore(tmp_path)
    assert again.delay_s(SinkPair("0", "f")) is None
    assert again.delay_s(SinkPair("1", "f")) == again.delay_s(HEADPHONES) == 0.1


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
    assert store.delay_s(HEADPHONES) is None
    assert "damaged" in store.warning
    assert "cushion sync" in store.warning
    assert (tmp_path / DAMAGED).read_text() == content
    store.store(HEADPHONES, 0.1)
    assert (store.warning, OffsetStore(tmp_path).delay_s(HEADPHONES)) == ("", 0.1)


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
        store.store(HEADPHONES, 0.1)
    assert store.delay_s(HEADPHONES) == 0.1


def test_a_full_disk_keeps_the_old_file_and_the_new_delay_until_the_end(small_disk):
    store = OffsetStore(small_disk)
    store.store(HEADPHONES, 0.1)
    (small_disk / "filler").write_bytes(b"\0" * 24_000)
    store._delays_s |= {SinkPair(f"sink {one}", "f" * 90): 0.1 for one in range(100)}
    with pytest.raises(CushionError, match="disk is full"):
        store.store(SPEAKERS, 0.2)
    assert (store.delay_s(SPEAKERS), OffsetStore(small_disk).delay_s(HEADPHONES)) == (0.2, 0.1)
