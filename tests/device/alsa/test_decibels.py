"""What a driver's table says of a volume's steps, and that no step is taken that is too loud."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.alsa.decibels import Decibels, parse_decibels
from device.alsa.mixer import CardMixer
from device.errors import NotFoundError

CONTAINER, SCALE, LINEAR, RANGE, BOUNDS, BOUNDS_MUTE = range(6)
SILENT_WHEN_LOWEST = 0x10000


def table(kind: int, *words: int) -> list[int]:
    """A table with its length right; numbers below zero as the kernel writes them."""
    return [kind, 4 * len(words), *(word & 0xFFFFFFFF for word in words)]


def known(words: list[int], lowest: int = 0, highest: int = 100) -> Decibels:
    decibels = parse_decibels(words, lowest, highest)
    assert decibels is not None
    return decibels


def levels(words: list[int], *steps: int, highest: int = 100) -> list[float]:
    return [round(known(words, 0, highest).level(step), 6) for step in steps]


def test_a_scale_counts_steps_of_one_size_from_its_lowest() -> None:
    assert levels(table(SCALE, -5_000, 50), 0, 1, 100) == [-50.0, -49.5, 0.0]


def test_bounds_are_the_levels_of_the_lowest_and_the_highest_step() -> None:
    assert levels(table(BOUNDS, -6_400, 0), 0, 50, 100) == [-64.0, -32.0, 0.0]


@pytest.mark.parametrize(
    "words", [table(SCALE, -5_000, 50 | SILENT_WHEN_LOWEST), table(BOUNDS_MUTE, -6_400, 0)]
)
def test_the_lowest_step_is_silence_where_the_table_says_so(words: list[int]) -> None:
    assert known(words).level(0) == -math.inf
    assert known(words).level(1) > -70.0


def test_linear_steps_are_steps_of_amplitude() -> None:
    assert levels(table(LINEAR, -9_999_999, 0), 0, 50, 100) == [-math.inf, -6.0206, 0.0]
    assert levels(table(LINEAR, -2_000, 0), 0, 100) == [-20.0, 0.0]
    assert levels(table(LINEAR, 2_000_000_000, 2_100_000_000), 0, 100) == [1_000.0, 1_000.0]


def test_ranges_have_a_table_each() -> None:
    words = table(RANGE, 0, 0, *table(SCALE, -9_000, 0), 1, 100, *table(SCALE, -5_000, 50))
    assert levels(words, 0, 1, 100) == [-90.0, -50.0, -0.5]


def test_a_table_in_a_container_is_found_behind_what_is_none() -> None:
    words = table(CONTAINER, *table(0x101, 1, 2, 3), *table(BOUNDS, -6_400, 0))
    assert levels(words, 0, 100) == [-64.0, 0.0]


@pytest.mark.parametrize(
    ("words", "lowest", "highest"),
    [
        ([], 0, 100),
        ([BOUNDS], 0, 100),
        ([BOUNDS, 8, 0], 0, 100),
        (table(BOUNDS, -1), 0, 100),
        (table(77, -6_400, 0), 0, 100),
        (table(BOUNDS, 0, -6_400), 0, 100),
        (table(BOUNDS, -6_400, 0), 5, 5),
        (table(RANGE), 0, 100),
        (table(RANGE, 0, 100, *table(77, 1, 2)), 0, 100),
        (table(CONTAINER, *table(77, 1, 2)), 0, 100),
    ],
)
def test_what_is_no_table_or_contradicts_itself_says_nothing(
    words: list[int], lowest: int, highest: int
) -> None:
    assert parse_decibels(words, lowest, highest) is None


def test_a_table_that_holds_itself_ends() -> None:
    words = table(BOUNDS, -6_400, 0)
    for _ in range(100):
        words = table(CONTAINER, *words)
    assert parse_decibels(words, 0, 100) is None


@given(
    st.lists(st.integers(0, (1 << 32) - 1) | st.integers(0, 40), max_size=24),
    st.integers(-(1 << 31), 1 << 31),
    st.integers(0, 1 << 20),
)
def test_any_words_give_levels_or_nothing(words: list[int], lowest: int, steps: int) -> None:
    decibels = parse_decibels(words, lowest, lowest + steps)
    if decibels is not None:
        assert decibels.lowest_db <= decibels.highest_db


@given(st.floats(-120.0, 20.0), st.integers(-12_000, -1), st.integers(0, 1_000))
def test_the_step_taken_is_the_highest_that_is_not_too_loud(
    wanted_db: float, first: int, last: int
) -> None:
    decibels = known(table(BOUNDS_MUTE, first, last))
    step = decibels.step_at_most(wanted_db)
    assert step is not None  # the lowest is silence
    assert decibels.level(step) <= wanted_db + 1e-8
    if step < 100:
        assert decibels.level(step + 1) > wanted_db


def test_no_step_is_taken_where_all_are_too_loud() -> None:
    assert known(table(BOUNDS, -600, 0)).step_at_most(-6.5) is None


def test_a_card_that_is_not_there_has_no_mixer(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match=r"sound card 3 .* is missing; plug the card in"):
        CardMixer(3, tmp_path)


def test_a_file_that_is_no_card_is_told_as_one_that_does_not_answer(tmp_path: Path) -> None:
    (tmp_path / "controlC0").write_bytes(b"")
    with pytest.raises(NotFoundError, match="does not answer"):
        CardMixer(0, tmp_path)
