"""What another order changes, and what the running effect makes of another config."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.daemon.capture_queue import Feed
from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.run_config import Change, RunConfig, changes_between, words_of
from audioflinger_hook.sources import PushTap, TapAddress, TapClient
from audioflinger_hook.transform import TransformParameters
from device.address import DeviceAddress
from device.drive import ActuatorSettings
from device.errors import UsageError
from device.units import Float32Array
from tests.daemon.test_capture_queue import BLOCK, BLOCK_S, RATE_HZ, STILL, Live, music

MUSIC = music(1.0)
ORDER = RunConfig(TapAddress("default"), DeviceAddress("sink", "a"), Settings(), LiveSettings())


def wishing(**settings: Any) -> RunConfig:
    return replace(ORDER, settings=Settings(**settings))


def living(**live: Any) -> RunConfig:
    return replace(ORDER, live=LiveSettings(**live))


LEFT, RIGHT = ActuatorSettings((0,), "left"), ActuatorSettings((1,), "right")
SOFTER = replace(LEFT, gain_db=-3.0, polarity="inverted", delay_ms=4.0, channels=(3,))
BOTH = (LEFT, RIGHT)
SWAPPED = (replace(LEFT, source="right"), replace(RIGHT, source="left"))
EVERYTHING = "the effects"
TRANSFORM = "the transform"


@pytest.mark.parametrize(
    ("order", "changed", "words"),
    [
        *((ORDER, "", "nothing"), (wishing(gain_db=-3.0), "level", "the level")),
        (wishing(parameters=TransformParameters(partials_max=3)), "transform", TRANSFORM),
        (wishing(profile="game"), "transform", TRANSFORM),
        (wishing(form="reference", gain_db=-1.0), "level engine", f"the level, {EVERYTHING}"),
        (wishing(channels="each"), "engine", EVERYTHING),
        (wishing(effects_file=Path("x")), "engine", EVERYTHING),
        (replace(ORDER, tap=TapAddress("sink", "b")), "tap", "the tap"),
        (replace(ORDER, device=DeviceAddress("sink", "b")), "device", "the device"),
        (living(offset_ms=5.0), "offset", "the offset"),
        (living(device_volume_db=-6.0), "volume", "the device's volume"),
    ],
)
def test_an_order_changes_what_is_another_in_it(order, changed, words):
    found = changes_between(ORDER, order)
    assert {change.name.lower() for change in found} == {*changed.split()}
    assert words_of(found) == words


@pytest.mark.parametrize(
    ("before", "after", "changed"),
    [
        *(((LEFT,), (LEFT,), set()), (BOTH, (SOFTER, RIGHT), {Change.ACTUATORS})),
        (BOTH, SWAPPED, {Change.ACTUATORS}),
        (BOTH, (LEFT, replace(RIGHT, source="left")), {Change.ENGINE}),
        *(((LEFT,), BOTH, {Change.ENGINE}), ((), (LEFT,), {Change.ENGINE})),
        ((LEFT,), (), {Change.ENGINE}),
        ((LEFT,), (replace(LEFT, rig="consumer"),), {Change.ENGINE}),
        ((LEFT,), (replace(LEFT, damping="auto", gain_db=-1.0),), {Change.ENGINE}),
        ((LEFT,), (replace(LEFT, protection="on"),), {Change.ENGINE}),
    ],
)
def test_actuators_follow_while_they_play_unless_others_are_to_be_there(before, after, changed):
    found = changes_between(wishing(actuators=before), wishing(actuators=after))
    assert found == changed
    assert (words_of(found) == "the actuators") == (changed == {Change.ACTUATORS})


def hear(live: Live, blocks: range) -> Float32Array:
    """The vibration of these blocks of the music."""
    begun = len(live.felt)
    for block in blocks:
        live.feed.push(MUSIC[block * BLOCK : (block + 1) * BLOCK], block * BLOCK_S)
    return np.concatenate(live.felt[begun:])[:, 0]


def rms(frames: Float32Array) -> float:
    return float(np.sqrt(np.mean(np.square(frames, dtype=np.float64))))


def test_other_parameters_fade_the_vibration_out_and_begin_anew():
    live = Live(Feed())
    hear(live, range(90))
    top = TransformParameters(vibration_top_hz=120.0)
    live.engine.framework.change(Settings(parameters=top))
    vibration = hear(live, range(90, 180))
    assert np.abs(vibration[: BLOCK // 2]).max() > 1e-3
    assert abs(vibration[BLOCK - 1]) < 1e-6
    # It begins anew: as another effect that first hears the rest of the music.
    fresh = Live(Feed(), Settings(parameters=top))
    assert np.array_equal(vibration[BLOCK:], hear(fresh, range(91, 180)))
    assert rms(vibration[-RATE_HZ // 10 :]) > 1e-2


def test_of_many_changes_between_two_blocks_the_last_one_counts():
    live, plain = Live(Feed()), Live(Feed())
    for gain_db in (*range(-60, 0), -20):
        live.engine.framework.change(Settings(gain_db=float(gain_db)))
    vibration, loud = hear(live, range(180)), hear(plain, range(180))
    assert rms(vibration[BLOCK:]) == pytest.approx(0.1 * rms(loud[BLOCK:]), rel=0.05)
    assert live.engine.framework.mixer.failed_events == 0


def test_parameters_that_the_mix_cannot_have_are_refused_and_nothing_changes():
    narrow = Settings(parameters=TransformParameters(band_high_hz=3_000.0))
    low = Engine(TapClient(PushTap(1_000, 1)), 1_000, narrow, clocks=STILL).framework
    wrong = TransformParameters(band_low_hz=600.0, band_high_hz=1_900.0, window_s=0.2)
    with pytest.raises(UsageError, match="1000 Hz"):
        low.change(Settings(parameters=wrong))
    assert low.settings == narrow
    assert low.mixer.cycle(0.0).frames_written


@pytest.mark.parametrize(("samplerate", "block"), [(RATE_HZ, 1_024), (44_100, BLOCK)])
def test_other_blocks_or_rates_take_another_delay_line_with_the_same_offset(samplerate, block):
    live = Live(Feed())
    hear(live, range(40))
    live.engine.delay_line.offset_s = 0.1
    before = live.engine.delay_line
    live.engine.retarget(RATE_HZ, BLOCK)
    assert live.engine.delay_line is before
    live.engine.retarget(samplerate, block)
    after = live.engine.delay_line
    assert after is not before
    assert (after.samplerate_out, after.offset_s) == (samplerate, 0.1)
    assert after.status.target_s > 0.1 + 2.5 * block / RATE_HZ
    assert rms(hear(live, range(40, 80))) > 1e-3
