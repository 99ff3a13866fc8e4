import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from audioflinger_hook.mixer.track_mixer import VolumeRamp, gains_of, usable_gain
from device.layouts import layout, sides

SMALLEST_NORMAL = 2.0**-126


@pytest.mark.parametrize(
    ("asked", "used"),
    [
        *((asked, 0.0) for asked in (math.nan, -1.0, -0.0, -math.inf, 1e-40, SMALLEST_NORMAL / 2)),
        *((asked, asked) for asked in (SMALLEST_NORMAL, 0.25, 1.0)),
        *((asked, 1.0) for asked in (1.0000001, math.inf)),
    ],
)
def test_gains_that_make_no_sense_are_silence_and_none_amplifies(asked, used):
    assert (usable_gain(asked), math.copysign(1.0, usable_gain(asked))) == (used, 1.0)
    assert gains_of([asked], 3) == (float(np.float32(used)),) * 3


@given(st.lists(st.floats(), min_size=1, max_size=24), st.integers(1, 24))
@example([SMALLEST_NORMAL, 0.0], 1)
def test_every_gain_in_use_lies_in_0_to_1_and_is_no_subnormal(volume, channels):
    gains = gains_of(volume, channels)
    assert len(gains) == channels
    assert gains_of(gains, channels) == gains, "one each goes to each"
    assert all(gain == 0.0 or SMALLEST_NORMAL <= gain <= 1.0 for gain in gains)


# AudioFlinger's sides, written out by hand from its channel masks; a mono mix is ours
AOSP_SIDES: tuple[str, ...] = ("C", "LR", "LRC", "LRLR", "LRCLR", "LRCCLR", "LRCCLRC", "LRCCLRLR")
AOSP_SIDES += ("LRCCLRLRLRLR", "LRCCLRLRLRLRLR", "LRCCLRLRLRLRLRLR", "LRCLLRLRCLRCLCRLCRLRLCRR")


@pytest.mark.parametrize("channels", range(1, 25))
def test_left_and_right_volume_reach_exactly_their_sides(channels):
    left, right = np.float32(0.3), np.float32(0.9)
    expected = {"L": left, "R": right, "C": (left + right) * np.float32(0.5)}
    wanted = {len(aosp): aosp for aosp in AOSP_SIDES}.get(channels, sides(channels))
    source = np.random.default_rng(channels).uniform(-1, 1, (48, channels)).astype(np.float32)
    target, ramp = np.empty_like(source), VolumeRamp(channels, 48)
    ramp.mix(source, target, gains_of((0.3, 0.9), channels), np.empty_like(source), first=True)
    gains = np.array([expected[side] for side in wanted])
    np.testing.assert_array_equal(target, source * gains)
    mono = VolumeRamp(channels, 48)
    mono.mix(source[:, :1], target, tuple(gains), np.empty_like(source), first=True)
    np.testing.assert_array_equal(target, source[:, :1] * gains)


@pytest.mark.parametrize("channels", range(1, 33))
def test_every_channel_has_its_own_position_and_as_many_stand_left_as_right(channels):
    assert len(set(layout(channels))) == len(layout(channels)) == channels
    assert sides(channels).count("L") == sides(channels).count("R")


FRAMES = 64


@given(old=st.floats(0, 1), new=st.floats(0, 1))
def test_a_ramp_is_linear_over_exactly_one_buffer(old, new):
    ramp = VolumeRamp(1, FRAMES)
    ones, target, scratch = (np.ones((FRAMES, 1), np.float32) for _ in range(3))
    ramp.mix(ones, target, gains_of([old], 1), scratch, first=True)
    assert (target == np.float32(usable_gain(old))).all(), "the first has no ramp"
    ramp.mix(ones, target, gains_of([new], 1), scratch, first=True)
    old, new = usable_gain(old), usable_gain(new)
    expected = old + (new - old) * np.arange(FRAMES) / FRAMES
    # two float32 roundings of numbers up to 1
    np.testing.assert_allclose(target[:, 0], expected, rtol=0, atol=2 * 2.0**-23)
    ramp.mix(ones, target, gains_of([new], 1), scratch, first=True)
    np.testing.assert_array_equal(target, np.float32(new))
