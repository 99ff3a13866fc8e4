"""What the audio thread of the daemon runs: a busy machine takes nothing away for good."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from audioflinger_hook.clients import TapClient
from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.settings import Settings
from audioflinger_hook.taps import PushTap
from device.units import Float32Array
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


def heard(settings: Settings | None, seconds: float = 0.4) -> tuple[Engine, Float32Array]:
    """An engine that heard noise, and what went into its delay line."""
    tap = PushTap(RATE_HZ, 2)
    engine = Engine(TapClient(tap), RATE_HZ, settings, clocks=Clocks(lambda: 0.0, lambda: 0.0))
    written = []
    into_line = engine.delay_line.write

    def write(vibration, now_s, earlier=()):
        written.append(vibration.copy())
        into_line(vibration, now_s, earlier)

    engine.delay_line.write = write  # type: ignore[method-assign]
    for number in range(round(seconds * RATE_HZ / 256)):
        tap.push(0.3 * noise(256, 2, number).astype(np.float32))
        assert engine.advance(number * 256 / RATE_HZ)
    tap.end()
    written.append(engine.finish(0.0))
    return engine, np.concatenate(written)


def test_protection_passes_on_the_same_vibration_whole_as_much_later_as_it_says() -> None:
    plain, usual = heard(None)
    assert plain.driving is None
    engine, protected = heard(Settings(protection="on"))
    assert engine.driving is not None
    late = engine.driving.latency_frames
    assert late == 192
    assert usual.any()
    assert np.array_equal(protected[late:], usual)
    assert not protected[:late].any()
    assert engine.driving.protection().limited_blocks == 0


def test_damping_changes_what_goes_out_and_not_what_recordings_and_levels_are_told() -> None:
    plain, usual = heard(None)
    engine, damped = heard(Settings(damping="auto"))
    assert not np.array_equal(damped[192:], usual)
    assert np.isfinite(damped).all()
    assert engine.vibration.loudest == plain.vibration.loudest


def test_what_protection_holds_when_it_goes_to_rest_does_not_come_with_the_next_sound() -> None:
    tap = PushTap(RATE_HZ, 1)
    engine = Engine(
        TapClient(tap),
        RATE_HZ,
        Settings(protection="on"),
        clocks=Clocks(lambda: 0.0, lambda: 0.0),
    )
    assert engine.driving is not None
    engine.driving.process(np.full((256, 1), 0.5, np.float32))
    blocks = engine.driving.protection().blocks
    engine.rest()
    assert not engine.driving.process(np.zeros((256, 1), np.float32)).any()
    assert engine.driving.protection().blocks > blocks  # counts go on
