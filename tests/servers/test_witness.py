"""The measure of clicks finds lost cycles, and only a torn bare server excuses a test."""

from __future__ import annotations

import numpy as np
import pytest

from device.units import Float32Array
from tests.servers.daemons import tone
from tests.servers.listening import RATE_HZ
from tests.servers.witness import (
    BUSY,
    CLICK_DB,
    above_250_hz,
    give_up,
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


def test_attempts_that_all_failed_fail_unless_a_bare_server_was_torn() -> None:
    with pytest.raises(AssertionError, match="torn 2 times"):
        give_up("step", [1, 2, 3], BUSY - 1)
    with pytest.raises(pytest.skip.Exception, match="torn 3 times"):
        give_up("step", [1, 2, 3], BUSY)
