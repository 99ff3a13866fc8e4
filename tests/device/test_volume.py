import functools
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.daemon.outputs.base import DeviceVolume
from device.alsa.decibels import parse_decibels
from device.alsa.mixer import CardMixer
from device.errors import LostError, NotFoundError, UsageError
from device.volume_limit import limit_volume_db


def test_it_is_set_at_each_opening_and_between_them_only_where_another_is_wanted():
    volume, levels_db = DeviceVolume(), list[float]()
    volume.set(levels_db.append)
    assert (levels_db, volume.warning) == ([], "")
    for wanted_db in (-6.0, -6.0, -20.0, -20.0, None, -20.0):
        volume.wanted_db = wanted_db
        volume.update(levels_db.append)
    assert levels_db == [-6.0, -20.0, -20.0]
    volume.set(levels_db.append)
    assert levels_db[3:] == [-20.0]


def refuse(wanted_db: float) -> None:
    raise UsageError("it has no volume")


def lose(wanted_db: float) -> None:
    raise LostError("gone")


def test_a_device_that_cannot_does_not_play_and_is_asked_again_each_time():
    volume = DeviceVolume(-6.0)
    for attempt in (volume.set, volume.update, volume.update):
        words = "device_volume_db = -6 cannot be set.*it has no volume.*-db off"
        with pytest.raises(NotFoundError, match=words):
            attempt(refuse)
    levels_db: list[float] = []
    volume.update(levels_db.append)
    assert levels_db == [-6.0]
    volume.wanted_db = None
    volume.update(refuse)  # nothing is asked of it
    volume = DeviceVolume(-6.0)
    with pytest.raises(LostError):  # that the server is lost is no refusal of the device
        volume.set(lose)
    volume.update(levels_db.append)
    assert levels_db == [-6.0, -6.0]


def test_more_than_the_rig_allows_is_never_set_and_that_is_told():
    volume, levels_db = DeviceVolume(0.0, -6.0), list[float]()
    volume.set(levels_db.append)
    assert levels_db == [-6.0]
    warning = "device_volume_db = 0: the rig allows at most -6 dB, which is set instead"
    assert volume.warning == warning
    volume.wanted_db, volume.limit_db = -10.0, -6.0
    volume.update(levels_db.append)
    assert (levels_db, volume.warning) == ([-6.0, -10.0], "")
    volume.wanted_db, volume.limit_db = -10.0, -20.0
    volume.update(levels_db.append)
    assert (levels_db[2:], bool(volume.warning)) == ([-20.0], True)
    volume.wanted_db = None
    volume.update(levels_db.append)
    assert (levels_db[3:], volume.warning) == ([], "")


@given(st.floats(allow_nan=False), st.floats(-80.0, 20.0))
def test_no_level_above_0_db_nor_the_limit_is_ever_set(wanted_db, limit_db):
    level_db = limit_volume_db(wanted_db, -math.inf, "the device", limit_db)
    assert level_db <= min(0.0, limit_db)
    assert level_db == wanted_db or wanted_db > min(0.0, limit_db)
    with pytest.raises(UsageError, match="cannot be set safely"):
        limit_volume_db(-6.0, 1.0, "the device")


CONTAINER, SCALE, LINEAR, RANGE, BOUNDS, BOUNDS_MUTE = range(6)
SILENT_WHEN_LOWEST = 0x10000
words_of_a_driver = st.lists(st.integers(0, (1 << 32) - 1) | st.integers(0, 40), max_size=24)


def table(kind: int, *words: int) -> list[int]:
    """A table with its length right; numbers below zero as the kernel writes them."""
    return [kind, 4 * len(words), *(word & 0xFFFFFFFF for word in words)]


def known(words: list[int]) -> Any:
    return parse_decibels(words, 0, 100)


A_SCALE, SOME_BOUNDS = table(SCALE, -5_000, 50), table(BOUNDS, -6_400, 0)
RANGES = table(RANGE, 0, 0, *table(SCALE, -9_000, 0), 1, 100, *A_SCALE)
BEHIND = table(CONTAINER, *table(0x101, 1, 2, 3), *SOME_BOUNDS)
"""Bounds in a container, behind what is no table of levels."""


@pytest.mark.parametrize(
    ("words", "levels_db"),
    [
        (A_SCALE, {0: -50.0, 1: -49.5, 100: 0.0}),
        (SOME_BOUNDS, {0: -64.0, 50: -32.0, 100: 0.0}),
        (table(LINEAR, -9_999_999, 0), {0: -math.inf, 50: -6.0206, 100: 0.0}),  # of amplitude
        (table(LINEAR, -2_000, 0), {0: -20.0, 100: 0.0}),
        (table(LINEAR, 2_000_000_000, 2_100_000_000), {0: 1_000.0, 100: 1_000.0}),
        (RANGES, {0: -90.0, 1: -50.0, 100: -0.5}),
        (BEHIND, {0: -64.0, 100: 0.0}),
    ],
)
def test_each_kind_of_table_gives_the_steps_their_levels(words, levels_db):
    assert {step: round(known(words).level(step), 6) for step in levels_db} == levels_db


def test_above_the_last_range_every_step_has_the_level_of_its_end():
    words = table(RANGE, 0, 10, *table(SCALE, -2_000, 100), 11, 20, *table(SCALE, -1_000, 50))
    decibels: Any = parse_decibels(words, 0, 30)
    levels_db = {0: -20.0, 10: -10.0, 11: -10.0, 20: -5.5, 21: -5.5, 30: -5.5}
    assert {step: decibels.level(step) for step in levels_db} == levels_db
    assert (decibels.highest_db, decibels.step_at_most(-5.0)) == (-5.5, 30)


def test_the_lowest_step_is_silence_where_the_table_says_so_else_none_may_be_soft_enough():
    for words in (table(SCALE, -5_000, 50 | SILENT_WHEN_LOWEST), table(BOUNDS_MUTE, -6_400, 0)):
        assert known(words).level(0) == -math.inf
        assert known(words).level(1) > -70.0
    assert known(table(BOUNDS, -600, 0)).step_at_most(-6.5) is None


NO_LEVELS = table(77, 1, 2)
HOLDS_ITSELF = functools.reduce(lambda words, _: table(CONTAINER, *words), range(100), SOME_BOUNDS)


@pytest.mark.parametrize(
    "words",
    [
        *([], [BOUNDS], [BOUNDS, 8, 0], table(BOUNDS, -1), table(77, -6_400, 0)),
        *(table(BOUNDS, 0, -6_400), table(RANGE), table(RANGE, 0, 100, *NO_LEVELS)),
        *(table(CONTAINER, *NO_LEVELS), HOLDS_ITSELF),
    ],
)
def test_what_is_no_table_or_contradicts_itself_says_nothing(words):
    assert parse_decibels(words, 0, 100) is None
    assert parse_decibels(SOME_BOUNDS, 5, 5) is None


@given(words_of_a_driver, st.integers(-(1 << 31), 1 << 31), st.integers(0, 1 << 20))
def test_any_words_give_levels_or_nothing(words, lowest, steps):
    decibels = parse_decibels(words, lowest, lowest + steps)
    if decibels is not None:
        assert decibels.lowest_db <= decibels.highest_db


@given(st.floats(-120.0, 20.0), st.integers(-12_000, -1), st.integers(0, 1_000))
def test_the_step_taken_is_the_highest_that_is_not_too_loud(wanted_db, first, last):
    decibels = known(table(BOUNDS_MUTE, first, last))
    step = decibels.step_at_most(wanted_db)
    assert step is not None  # the lowest is silence
    assert decibels.level(step) <= wanted_db + 1e-8
    if step < 100:
        assert decibels.level(step + 1) > wanted_db


def test_a_card_that_is_not_there_or_does_not_answer_has_no_mixer(tmp_path):
    with pytest.raises(NotFoundError, match=r"sound card 3 .* is missing; plug the card in"):
        CardMixer(3, tmp_path)
    (tmp_path / "controlC0").write_bytes(b"")  # a file that is no card
    with pytest.raises(NotFoundError, match="does not answer"):
        CardMixer(0, tmp_path)
