"""Volumes: what is usable, exact gains on every side, ramps over exactly one buffer."""

from __future__ import annotations

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
        (math.nan, 0.0),
        (-1.0, 0.0),
        (-0.0, 0.0),
        (-math.inf, 0.0),
        (1e-40, 0.0),
        (SMALLEST_NORMAL / 2, 0.0),
        (SMALLEST_NORMAL, SMALLEST_NORMAL),
        (0.25, 0.25),
        (1.0, 1.0),
        (1.0000001, 1.0),
        (math.inf, 1.0),
    ],
)
def test_gains_that_make_no_sense_are_silence_and_none_amplifies(asked: float, used: float) -> None:
    assert usable_gain(asked) == used
    assert math.copysign(1.0, usable_gain(asked)) == 1.0
    assert gains_of([asked], 3) == (float(np.float32(used)),) * 3


@given(st.lists(st.floats(), min_size=1, max_size=24), st.integers(1, 24))
@example([SMALLEST_NORMAL, 0.0], 1)
def test_every_gain_in_use_lies_in_0_to_1_and_is_no_subnormal(volume, channels) -> None:
    gains = gains_of(volume, channels)
    assert len(gains) == channels
    assert all(gain == 0.0 or SMALLEST_NORMAL <= gain <= 1.0 for gain in gains)


# AudioFlinger's sides, written out by hand from its channel masks; a mono mix is ours
AOSP_SIDES = {
    1: "C",
    2: "LR",
    3: "LRC",
    4: "LRLR",
    5: "LRCLR",
    6: "LRCCLR",
    7: "LRCCLRC",
    8: "LRCCLRLR",
    12: "LRCCLRLRLRLR",
    14: "LRCCLRLRLRLRLR",
    16: "LRCCLRLRLRLRLRLR",
    24: "LRCLLRLRCLRCLCRLCRLRLCRR",
}


@pytest.mark.parametrize("channels", range(1, 25))
def test_left_and_right_volume_reach_exactly_their_sides(channels: int) -> None:
    left, right = np.float32(0.3), np.float32(0.9)
    expected = {"L": left, "R": right, "C": (left + right) * np.float32(0.5)}
    wanted = AOSP_SIDES.get(channels, sides(channels))
    rng = np.random.default_rng(channels)
    source = rng.uniform(-1, 1, (48, channels)).astype(np.float32)
    target = np.empty_like(source)
    ramp = VolumeRamp(channels, 48)
    ramp.mix(source, target, gains_of((0.3, 0.9), channels), np.empty_like(source), first=True)
    for channel, side in enumerate(wanted):
        np.testing.assert_array_equal(target[:, channel], source[:, channel] * expected[side])


@pytest.mark.parametrize("channels", range(1, 33))
def test_every_channel_has_its_own_position_and_as_many_stand_left_as_right(channels: int) -> None:
    assert len(set(layout(channels))) == len(layout(channels)) == channels
    assert sides(channels).count("L") == sides(channels).count("R")


def test_one_gain_each_goes_to_each_channel() -> None:
    assert gains_of((0.0, 0.25, 0.5, 1.0), 4) == (0.0, 0.25, 0.5, 1.0)


FRAMES = 64


def ramp_and_buffers(channels: int = 2):
    source = np.random.default_rng(5).uniform(-1, 1, (FRAMES, channels)).astype(np.float32)
    return VolumeRamp(channels, FRAMES), source, np.zeros_like(source), np.zeros_like(source)


@given(old=st.floats(0, 1), new=st.floats(0, 1))
def test_a_ramp_is_linear_over_exactly_one_buffer(old: float, new: float) -> None:
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


def test_mixing_adds_to_what_is_there_and_reads_the_source_only() -> None:
    ramp, source, target, scratch = ramp_and_buffers()
    kept = source.copy()
    target[:] = 0.5
    ramp.mix(source, target, (1.0, 1.0), scratch, first=False)
    np.testing.assert_array_equal(target, np.float32(0.5) + source)
    ramp.mix(source, target, (0.5, 0.0), scratch, first=False)
    ramp.mix(source, target, None, scratch, first=False)
    np.testing.assert_array_equal(source, kept)
    assert ramp.gains == (0.0, 0.0)


def test_mono_goes_to_all_channels_with_each_channels_gain() -> None:
    ramp, _, target, scratch = ramp_and_buffers()
    mono = np.linspace(-1, 1, FRAMES, dtype=np.float32)[:, None]
    ramp.mix(mono, target, (1.0, 0.5), scratch, first=True)
    np.testing.assert_array_equal(target, mono * np.array([1.0, 0.5], np.float32))


def test_a_restarted_ramp_starts_without_one_and_a_muted_one_from_silence() -> None:
    ramp, source, target, scratch = ramp_and_buffers()
    assert ramp.gains is None
    ramp.mix(source, target, (1.0, 1.0), scratch, first=True)
    ramp.mute()
    ramp.mix(source, target, (1.0, 1.0), scratch, first=True)
    assert (target[0] == 0.0).all()
    ramp.mute()
    ramp.gains = None
    ramp.mix(source, target, (1.0, 1.0), scratch, first=True)
    np.testing.assert_array_equal(target, source)
