"""Measures find lost cycles and delays, and only a torn witness excuses an attempt."""

import numpy as np
import pytest

from device.units import Float32Array
from tests.servers import witness
from tests.servers.daemons import tone
from tests.servers.listening import RATE_HZ
from tools.live_latency.bursts import BurstDelays, burst_sound, onsets


def without_a_cycle(at: int, frames: int) -> Float32Array:
    whole = tone(110.0, 4.0)
    return np.concatenate([whole[:at], whole[at + frames :]])


def test_a_lost_cycle_tears_a_tone_and_counts_only_while_something_is_felt():
    whole = tone(110.0, 4.0)
    assert witness.tears(whole) == 0
    assert witness.above_250_hz(whole).max() < witness.CLICK_DB - 10.0
    assert not witness.silent_blocks(whole).any()
    for frames in (128, 256, 1_024):
        assert witness.tears(without_a_cycle(2 * RATE_HZ, frames)) > 0
    torn, felt = without_a_cycle(2 * RATE_HZ, 256), tone(110.0, 4.0)
    assert witness.tears(torn, felt) > 0
    felt[2 * RATE_HZ : 2 * RATE_HZ + RATE_HZ // 10] = 0.0
    assert witness.tears(torn, felt) == 0
    assert witness.tears(without_a_cycle(RATE_HZ, 256), felt) > 0


def test_a_second_failed_attempt_fails_and_does_not_count_but_skips_where_the_witness_was_torn():
    verdict = witness.Verdict("step")
    assert not verdict.add(1, good=True, witness_torn=False)
    assert not verdict.add(2, good=False, witness_torn=True)
    assert not verdict.add(3, good=False, witness_torn=False)
    with pytest.raises(AssertionError, match="step, after 1 clean attempts: 4"):
        verdict.add(4, good=False, witness_torn=False)
    verdict = witness.Verdict("step")
    assert [verdict.add(n, good=True, witness_torn=n > 1) for n in range(witness.CLEAN)][-1]
    verdict = witness.Verdict("step")
    for attempt in range(witness.EXCUSED - 1):
        assert not verdict.add(attempt, good=False, witness_torn=True)
    with pytest.raises(pytest.skip.Exception, match="too busy"):
        verdict.add(witness.EXCUSED, good=False, witness_torn=True)


def test_a_known_delay_is_found_to_the_sample():
    sound = burst_sound(9, RATE_HZ)
    assert len(onsets(sound, RATE_HZ)) == 9
    for delay in (0, 480, 2_400):
        felt = np.concatenate([np.zeros(delay), sound[: len(sound) - delay]])
        found = BurstDelays.of(sound, felt, RATE_HZ)
        assert found.half_ms.size == 9
        # the first sample of a cosine is its peak
        assert found.tenth_ms == pytest.approx(1e3 * delay / RATE_HZ)
        assert found.half_ms == pytest.approx(1e3 * delay / RATE_HZ)
