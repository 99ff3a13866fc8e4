"""The measure of clicks finds lost cycles, and only a torn witness excuses an attempt."""

from __future__ import annotations

import numpy as np
import pytest

from device.units import Float32Array
from tests.servers.daemons import tone
from tests.servers.listening import RATE_HZ
from tests.servers.witness import (
    CLEAN,
    CLICK_DB,
    EXCUSED,
    Verdict,
    above_250_hz,
    silent_blocks,
    tears,
)


def without_a_cycle(at: int, frames: int) -> Float32Array:
    """A tone that lacks these frames."""
    whole = tone(110.0, 4.0)
    return np.concatenate([whole[:at], whole[at + frames :]])


def test_a_whole_tone_is_not_torn_and_nothing_of_it_is_silent() -> None:
    whole = tone(110.0, 4.0)
    assert tears(whole) == 0
    assert above_250_hz(whole).max() < CLICK_DB - 10.0
    assert not silent_blocks(whole).any()


@pytest.mark.parametrize("frames", [128, 256, 1_024])
def test_a_lost_cycle_tears_a_tone(frames: int) -> None:
    assert tears(without_a_cycle(2 * RATE_HZ, frames)) > 0


def test_a_tear_counts_only_while_something_is_felt() -> None:
    torn, felt = without_a_cycle(2 * RATE_HZ, 256), tone(110.0, 4.0)
    assert tears(torn, felt) > 0
    felt[2 * RATE_HZ : 2 * RATE_HZ + RATE_HZ // 10] = 0.0
    assert tears(torn, felt) == 0
    assert tears(without_a_cycle(RATE_HZ, 256), felt) > 0


def test_a_second_failed_attempt_fails_unless_the_witness_was_torn_in_it() -> None:
    verdict = Verdict("step")
    assert not verdict.add(1, good=True, witness_torn=False)
    assert not verdict.add(2, good=False, witness_torn=True)
    assert not verdict.add(3, good=False, witness_torn=False)
    with pytest.raises(AssertionError, match="step, after 1 clean attempts: 4"):
        verdict.add(4, good=False, witness_torn=False)


def test_it_is_shown_after_some_clean_attempts_and_skipped_after_many_excused_ones() -> None:
    verdict = Verdict("step")
    assert [verdict.add(n, good=True, witness_torn=n > 1) for n in range(CLEAN)][-1]
    verdict = Verdict("step")
    for attempt in range(EXCUSED - 1):
        assert not verdict.add(attempt, good=False, witness_torn=True)
    with pytest.raises(pytest.skip.Exception, match="too busy"):
        verdict.add(EXCUSED, good=False, witness_torn=True)
