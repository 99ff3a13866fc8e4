"""Track channels in the mix: untouched, spread, folded; never over full scale, never lost."""

from __future__ import annotations

import numpy as np
import pytest

from audioflinger_hook.mixer.layouts import ChannelMap, mapping
from device.layouts import CHANNELS_MAX, layout

COUNTS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 12, 16, 24, 32)


def mapped(frames: np.ndarray, mix_channels: int) -> np.ndarray:
    channel_map = ChannelMap(frames.shape[1], mix_channels)
    place = np.full((len(frames), mix_channels), np.nan, np.float32)
    spare = np.full(len(frames), np.nan, np.float32)
    result = channel_map.apply(frames, place, spare)
    return np.broadcast_to(result, place.shape)


def noise(channels: int) -> np.ndarray:
    return np.random.default_rng(channels).uniform(-1, 1, (32, channels)).astype(np.float32)


@pytest.mark.parametrize("channels", range(1, CHANNELS_MAX + 1))
def test_the_same_count_is_the_same_memory(channels: int) -> None:
    frames = noise(channels)
    assert ChannelMap(channels, channels).apply(frames, frames, frames[:, 0]) is frames


@pytest.mark.parametrize("mix_channels", COUNTS)
def test_mono_goes_to_every_channel_as_it_is(mix_channels: int) -> None:
    frames = noise(1)
    np.testing.assert_array_equal(
        mapped(frames, mix_channels), np.repeat(frames, mix_channels, axis=1)
    )


@pytest.mark.parametrize("track_channels", COUNTS)
def test_a_mono_mix_is_the_mean_of_all(track_channels: int) -> None:
    frames = noise(track_channels)
    mean = frames.mean(axis=1, dtype=np.float64)
    np.testing.assert_allclose(mapped(frames, 1)[:, 0], mean, rtol=0, atol=1e-6)


@pytest.mark.parametrize("track_channels", COUNTS)
@pytest.mark.parametrize("mix_channels", COUNTS)
def test_no_channel_is_lost_and_none_can_exceed_full_scale(
    track_channels: int, mix_channels: int
) -> None:
    matrix = mapping(track_channels, mix_channels)
    assert (matrix.sum(axis=1) > 0.0).all()
    # one float32 rounding a route
    assert matrix.sum(axis=0, dtype=np.float64).max() <= 1.0 + 1e-6
    expected = noise(track_channels).astype(np.float64) @ matrix
    np.testing.assert_allclose(
        mapped(noise(track_channels), mix_channels), expected, rtol=0, atol=1e-6
    )


def test_stereo_stands_in_front_of_a_surround_mix() -> None:
    frames = noise(2)
    surround = mapped(frames, 6)
    np.testing.assert_array_equal(surround[:, :2], frames)
    assert not surround[:, 2:].any()


def test_a_channel_goes_to_its_own_position_not_to_its_index() -> None:
    quad = noise(4)
    surround = mapped(quad, 6)
    assert layout(4)[2] == layout(6)[4] == "BL"
    np.testing.assert_array_equal(surround[:, [0, 1, 4, 5]], quad)


def test_surround_folds_to_stereo_with_equal_weight_on_both_sides() -> None:
    matrix = mapping(6, 2)
    left, right = matrix[:, 0], matrix[:, 1]
    minus_3_db = 0.5**0.5
    np.testing.assert_allclose(left / left[0], [1, 0, minus_3_db, minus_3_db, minus_3_db, 0])
    np.testing.assert_allclose(right / right[1], [0, 1, minus_3_db, minus_3_db, 0, minus_3_db])
    assert left.sum() == pytest.approx(1.0)


def test_the_right_channel_counts_as_much_as_the_left_everywhere() -> None:
    for track_channels in COUNTS:
        for mix_channels in COUNTS[1:]:
            if 1 in (track_channels, mix_channels):
                continue
            matrix = mapping(track_channels, mix_channels)
            assert matrix[0].sum() == matrix[1].sum()
