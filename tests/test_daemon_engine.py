"""What the audio thread of the daemon runs: a busy machine takes nothing away for good."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from audioflinger_hook.clients import TapClient
from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.taps import PushTap
from tests.commands import noise

RATE_HZ = 48_000
SLOW_S = 0.05
"""Ten times a buffer, from one look at a clock to the next."""


@pytest.mark.parametrize(
    ("now_step_s", "used_step_s", "bypass_late", "bypassed"),
    [
        (SLOW_S, 0.0, True, False),
        (SLOW_S, SLOW_S, True, True),
        (SLOW_S, SLOW_S, False, False),
    ],
)
def test_an_effect_is_passed_by_for_the_time_it_uses_not_for_that_of_others(
    now_step_s, used_step_s, bypass_late, bypassed
):
    now, used = itertools.count(), itertools.count()
    clocks = Clocks(lambda: now_step_s * next(now), lambda: used_step_s * next(used))
    tap = PushTap(RATE_HZ, 2)
    engine = Engine(TapClient(tap), RATE_HZ, clocks=clocks, bypass_late=bypass_late)
    for number in range(20):
        tap.push(noise(256, 2, number).astype(np.float32))
        assert engine.advance(number * 256 / RATE_HZ)
    assert bool(engine.framework.bypassed()) is bypassed


def test_a_buffer_too_short_for_a_frame_of_the_mix_waits_for_the_next() -> None:
    tap = PushTap(RATE_HZ, 1)
    client = TapClient(tap)
    engine = Engine(client, RATE_HZ, clocks=Clocks(lambda: 0.0, lambda: 0.0))
    tap.change(8 * RATE_HZ, 1)
    for _ in range(80):
        tap.push(np.zeros((1, 1), np.float32))
        assert engine.advance(0.0)
    assert engine.frames == 10
    assert client.buffers == 80
    tap.end()
    assert len(engine.finish(0.0)) >= engine.framework.latency_frames
    assert not engine.advance(0.0)
