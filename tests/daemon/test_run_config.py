"""What another order changes, and what the running effect makes of another config."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.daemon.run_config import ConfigDiff, RunConfig
from audioflinger_hook.sources import PushTap, TapAddress, TapClient
from audioflinger_hook.transform import TransformParameters
from device.address import DeviceAddress
from device.drive import ActuatorSettings
from device.errors import UsageError
from device.units import Float32Array

RATE_HZ = 48_000
BLOCK = 256
ORDER = RunConfig(TapAddress("default"), DeviceAddress("sink", "a"), Settings(), LiveSettings())


@pytest.mark.parametrize(
    ("order", "changed", "words"),
    [
        (ORDER, ConfigDiff(), "nothing"),
        (replace(ORDER, settings=Settings(gain_db=-3.0)), ConfigDiff(level=True), "the level"),
        (
            replace(ORDER, settings=Settings(parameters=TransformParameters(partials_max=3))),
            ConfigDiff(transform=True),
            "the transform, which restarts",
        ),
        (
            replace(ORDER, settings=Settings(profile="game")),
            ConfigDiff(transform=True),
            "the transform, which restarts",
        ),
        (
            replace(ORDER, settings=Settings(form="reference", gain_db=-1.0)),
            ConfigDiff(level=True, engine=True),
            "the level, the effects, which restart everything",
        ),
        (replace(ORDER, settings=Settings(channels="each")), ConfigDiff(engine=True), None),
        (replace(ORDER, settings=Settings(effects_file=Path("x"))), ConfigDiff(engine=True), None),
        (replace(ORDER, tap=TapAddress("sink", "b")), ConfigDiff(tap=True), "the tap"),
        (replace(ORDER, device=DeviceAddress("sink", "b")), ConfigDiff(device=True), "the device"),
        (replace(ORDER, live=LiveSettings(offset_ms=5.0)), ConfigDiff(offset=True), "the offset"),
        (
            replace(ORDER, live=LiveSettings(device_volume_db=-6.0)),
            ConfigDiff(volume=True),
            "the device's volume",
        ),
        (replace(ORDER, live=LiveSettings(block_frames=256)), ConfigDiff(blocks=True), None),
        (replace(ORDER, live=LiveSettings(realtime=False)), ConfigDiff(priority=True), None),
    ],
)
def test_an_order_changes_what_is_another_in_it(
    order: RunConfig, changed: ConfigDiff, words: str | None
) -> None:
    found = ConfigDiff.between(ORDER, order)
    assert found == changed
    assert found.any == (changed != ConfigDiff())
    if words is not None:
        assert str(found) == words


LEFT = ActuatorSettings((0,), "left")
RIGHT = ActuatorSettings((1,), "right")


def with_actuators(*actuators: ActuatorSettings) -> RunConfig:
    return replace(ORDER, settings=Settings(actuators=actuators))


@pytest.mark.parametrize(
    ("before", "after", "changed", "words"),
    [
        ((LEFT,), (LEFT,), ConfigDiff(), "nothing"),
        (
            (LEFT, RIGHT),
            (replace(LEFT, gain_db=-3.0, polarity="inverted", delay_ms=4.0, channels=(3,)), RIGHT),
            ConfigDiff(actuators=True),
            "the actuators",
        ),
        (
            (LEFT, RIGHT),
            (replace(LEFT, source="right"), replace(RIGHT, source="left")),
            ConfigDiff(actuators=True),
            None,
        ),
        ((LEFT, RIGHT), (LEFT, replace(RIGHT, source="left")), ConfigDiff(engine=True), None),
        ((LEFT,), (LEFT, RIGHT), ConfigDiff(engine=True), None),
        ((), (LEFT,), ConfigDiff(engine=True), None),
        ((LEFT,), (), ConfigDiff(engine=True), None),
        ((LEFT,), (replace(LEFT, rig="consumer"),), ConfigDiff(engine=True), None),
        ((LEFT,), (replace(LEFT, damping="auto", gain_db=-1.0),), ConfigDiff(engine=True), None),
        ((LEFT,), (replace(LEFT, protection="on"),), ConfigDiff(engine=True), None),
    ],
)
def test_actuators_follow_while_they_play_unless_others_are_to_be_there(
    before: tuple[ActuatorSettings, ...],
    after: tuple[ActuatorSettings, ...],
    changed: ConfigDiff,
    words: str | None,
) -> None:
    found = ConfigDiff.between(with_actuators(*before), with_actuators(*after))
    assert found == changed
    if words is not None:
        assert str(found) == words


class Live:
    """An engine that hears one long tone, block by block; keeps the vibration that it sends."""

    def __init__(self, settings: Settings | None = None) -> None:
        self.tap = PushTap(RATE_HZ, 2)
        self.sent: list[Float32Array] = []
        self.engine = Engine(
            TapClient(self.tap),
            RATE_HZ,
            settings,
            clocks=Clocks(lambda: 0.0, lambda: 0.0),
            on_step=lambda audio, vibration, now_s: self.sent.append(vibration.copy()),
        )
        self.blocks = 0

    def hear(self, seconds: float) -> Float32Array:
        """The vibration of so much more of the tone."""
        began = len(self.sent)
        for _ in range(round(seconds * RATE_HZ / BLOCK)):
            at = (self.blocks * BLOCK + np.arange(BLOCK)) / RATE_HZ
            wave = (0.3 * np.sin(2.0 * np.pi * 440.0 * at)).astype(np.float32)
            self.tap.push(np.column_stack([wave, wave]))
            self.engine.advance(self.blocks * BLOCK / RATE_HZ)
            self.blocks += 1
        return np.concatenate(self.sent[began:])[:, 0]


def rms(frames: Float32Array) -> float:
    return float(np.sqrt(np.mean(np.square(frames, dtype=np.float64))))


def test_another_level_is_reached_over_one_block_and_nothing_else_changes() -> None:
    live, unchanged = Live(), Live()
    live.hear(0.5)
    unchanged.hear(0.5)
    live.engine.framework.change(Settings(gain_db=-20.0))
    vibration, whole = live.hear(0.5), unchanged.hear(0.5)
    ramp = 1.0 + (0.1 - 1.0) * np.arange(1, BLOCK + 1) / BLOCK
    assert np.allclose(vibration[:BLOCK], whole[:BLOCK] * ramp, atol=1e-7)
    assert np.allclose(vibration[BLOCK:], whole[BLOCK:] * 0.1, atol=1e-7)


def test_a_level_that_was_chosen_from_the_start_holds_from_the_first_frame_on() -> None:
    loud, soft = Live(), Live(Settings(gain_db=-20.0))
    assert np.allclose(0.1 * loud.hear(0.5), soft.hear(0.5), atol=1e-7)


def test_other_parameters_fade_the_vibration_out_and_begin_anew() -> None:
    live = Live()
    live.hear(0.5)
    top = TransformParameters(vibration_top_hz=120.0)
    live.engine.framework.change(Settings(parameters=top))
    began = live.blocks
    vibration = live.hear(0.5)
    assert np.abs(vibration[: BLOCK // 2]).max() > 1e-3
    assert abs(vibration[BLOCK - 1]) < 1e-6
    # It begins anew: as another effect that first hears the rest of the tone.
    fresh = Live(Settings(parameters=top))
    fresh.blocks = began + 1
    rest = [fresh.hear(BLOCK / RATE_HZ) for _ in range(live.blocks - began - 1)]
    assert np.array_equal(vibration[BLOCK:], np.concatenate(rest))
    assert rms(vibration[-RATE_HZ // 10 :]) > 1e-2


def test_of_many_changes_between_two_blocks_the_last_one_counts() -> None:
    live = Live()
    loud = rms(live.hear(0.5))
    for gain_db in range(-60, 0):
        live.engine.framework.change(Settings(gain_db=float(gain_db)))
    live.engine.framework.change(Settings(gain_db=-20.0))
    live.hear(0.1)
    assert rms(live.hear(0.5)) == pytest.approx(0.1 * loud, rel=0.05)
    assert live.engine.framework.mixer.failed_events == 0


def test_parameters_that_the_mix_cannot_have_are_refused_and_nothing_changes() -> None:
    tap = PushTap(8_000, 1)
    clocks = Clocks(lambda: 0.0, lambda: 0.0)
    narrow = Settings(parameters=TransformParameters(band_high_hz=3_000.0))
    engine = Engine(TapClient(tap), 8_000, narrow, clocks=clocks)
    wrong = TransformParameters(band_low_hz=900.0, band_high_hz=1_900.0, window_s=0.2)
    framework = engine.framework
    framework.change(Settings(parameters=wrong))
    assert framework.settings.parameters == wrong
    low = Engine(TapClient(PushTap(1_000, 1)), 1_000, narrow, clocks=clocks).framework
    with pytest.raises(UsageError, match="1000 Hz"):
        low.change(Settings(parameters=replace(wrong, band_low_hz=600.0)))
    assert low.settings == narrow
    assert low.mixer.cycle(0.0).frames_written


def test_what_an_engine_cannot_have_changes_neither_level_nor_offset() -> None:
    live = Live()
    with pytest.raises(UsageError, match="offset_s"):
        live.engine.follow(Settings(gain_db=-20.0), 5.0)
    assert live.engine.framework.settings == Settings()
    live.engine.follow(Settings(gain_db=-20.0), 0.5)
    assert live.engine.delay_line.offset_s == 0.5
    assert live.engine.framework.settings.gain_db == -20.0


def test_other_blocks_take_another_delay_line_with_the_same_offset() -> None:
    live = Live()
    live.hear(0.2)
    live.engine.delay_line.offset_s = 0.1
    before = live.engine.delay_line
    live.engine.retarget(RATE_HZ, BLOCK)
    assert live.engine.delay_line is before
    live.engine.retarget(RATE_HZ, 1_024)
    assert live.engine.delay_line is not before
    assert live.engine.delay_line.offset_s == 0.1
    assert live.engine.delay_line.status.target_s > 0.1 + 2.5 * 1_024 / RATE_HZ
    assert rms(live.hear(0.2)) > 1e-3
