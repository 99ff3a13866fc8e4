"""What the audio thread of the daemon runs: a busy machine takes nothing away for good."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.service.meters import FLOOR_DBFS
from audioflinger_hook.sources import PushTap, TapClient
from device.drive import ActuatorSettings
from device.units import Float32Array
from tests.support.commands import noise

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
    assert plain.drive.processors == (None,)
    engine, protected = heard(Settings(protection="on"))
    late = engine.drive.latency_frames
    assert late == 192
    assert usual.any()
    assert np.array_equal(protected[late:], usual)
    assert not protected[:late].any()
    processor = engine.drive.processors[0]
    assert processor is not None
    assert processor.protection().limited_blocks == 0


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
    processor = engine.drive.processors[0]
    assert processor is not None
    engine.drive.process(np.full((256, 1), 0.5, np.float32))
    blocks = processor.protection().blocks
    engine.rest()
    assert not engine.drive.process(np.zeros((256, 1), np.float32)).any()
    assert processor.protection().blocks > blocks  # counts go on


LEFT = ActuatorSettings((0,), "left")
RIGHT = ActuatorSettings((1,), "right", polarity="inverted", delay_ms=10.0)


def test_actuators_get_their_sources_and_what_is_recorded_is_the_vibration_before_them() -> None:
    _, each = heard(Settings(channels="each"))
    engine, driven = heard(Settings(actuators=(RIGHT, LEFT)))
    assert engine.drive.processors == (None, None)
    assert engine.drive.outputs == 2
    assert engine.framework.haptic_channels == 2
    assert np.array_equal(driven[: len(each), 1], each[:, 0])
    late = engine.drive.delays_frames[0]
    assert late == 480
    assert np.array_equal(driven[late:, 0], -each[:, 1])
    assert not driven[:late, 0].any()


def test_one_with_protection_keeps_all_of_them_together() -> None:
    _, plain = heard(Settings(actuators=(LEFT, RIGHT)))
    protected = ActuatorSettings((0,), "left", protection="on")
    engine, driven = heard(Settings(actuators=(protected, RIGHT)))
    late = engine.drive.latency_frames
    assert late == 192
    assert np.array_equal(driven[late:], plain)


def test_actuators_follow_another_order_and_each_one_s_level_is_told() -> None:
    tap = PushTap(RATE_HZ, 2)
    settings = Settings(actuators=(LEFT, RIGHT))
    clocks = Clocks(lambda: 0.0, lambda: 0.0)
    engine = Engine(TapClient(tap), RATE_HZ, settings, clocks=clocks)
    sent: list[Float32Array] = []
    into_line = engine.delay_line.write

    def write(vibration, now_s, earlier=()):
        sent.append(vibration.copy())
        into_line(vibration, now_s, earlier)

    engine.delay_line.write = write  # type: ignore[method-assign]
    wave = 0.3 * np.sin(2.0 * np.pi * 110.0 * np.arange(RATE_HZ) / RATE_HZ).astype(np.float32)
    for start in range(0, RATE_HZ // 256 * 256, 256):
        if start == 94 * 256:
            silent = ActuatorSettings((0,), "left", gain_db=-60.0)
            engine.follow(Settings(actuators=(silent, RIGHT)), 0.0)
        tap.push(np.column_stack([wave[start : start + 256]] * 2))
        engine.advance(start / RATE_HZ)
    before, after = np.concatenate(sent[60:94]), np.concatenate(sent[-60:])
    assert np.abs(after[:, 0]).max() == pytest.approx(1e-3 * np.abs(before[:, 0]).max(), rel=0.1)
    assert np.abs(after[:, 1]).max() == pytest.approx(np.abs(before[:, 1]).max(), rel=0.1)
    quiet, loud = (gathered.meter.level() for gathered in engine.driven)
    # Half a second on, with a time constant of 0.3 s for the power: 7 dB.
    assert quiet.rms_dbfs == pytest.approx(loud.rms_dbfs - 7.2, abs=1.0)
    engine.rest()
    assert engine.driven[1].meter.level().rms_dbfs == FLOOR_DBFS
    assert not engine.drive.process(np.zeros((2_000, 2), np.float32)).any()


def test_a_device_is_filled_with_a_column_for_each_actuator() -> None:
    engine, _ = heard(Settings(actuators=(LEFT, RIGHT, ActuatorSettings((2,), "mix"))))
    out = np.zeros((256, 3), np.float32)
    engine.fill(out, 0.0)
    assert np.isfinite(out).all()
    assert engine.read_ahead.shape[1] == 3
