"""Track channels in the mix: untouched, spread, folded; never over full scale, never lost."""

import numpy as np
import pytest

from audioflinger_hook.mixer.layouts import ChannelMap, mapping
from device.layouts import CHANNELS_MAX, layout
from tests.support.taps import noise

COUNTS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 12, 16, 24, 32)


def mapped(frames, mix_channels):
    channel_map = ChannelMap(frames.shape[1], mix_channels)
    place = np.full((len(frames), mix_channels), np.nan, np.float32)
    return np.broadcast_to(channel_map.apply(frames, place, place[:, 0].copy()), place.shape)


@pytest.mark.parametrize("channels", range(1, CHANNELS_MAX + 1))
def test_the_same_count_is_the_same_memory(channels):
    frames = noise(32, channels)
    assert ChannelMap(channels, channels).apply(frames, frames, frames[:, 0]) is frames


@pytest.mark.parametrize("track_channels", COUNTS)
@pytest.mark.parametrize("mix_channels", COUNTS)
def test_no_channel_is_lost_and_none_can_exceed_full_scale(track_channels, mix_channels):
    matrix, frames = mapping(track_channels, mix_channels), noise(32, track_channels)
    assert (matrix.sum(axis=1) > 0.0).all()
    if 1 not in (track_channels, mix_channels):
        assert matrix[0].sum() == matrix[1].sum(), "left and right count the same"
    # one float32 rounding a route
    assert matrix.sum(axis=0, dtype=np.float64).max() <= 1.0 + 1e-6
    expected = frames.astype(np.float64) @ matrix
    if track_channels == 1:  # goes to every channel as it is
        assert np.array_equal(mapped(frames, mix_channels), expected)
    elif mix_channels == 1:
        expected = frames.mean(axis=1, dtype=np.float64, keepdims=True)
    np.testing.assert_allclose(mapped(frames, mix_channels), expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("channels", "places"), [(2, [0, 1]), (4, [0, 1, 4, 5])])
def test_a_channel_goes_to_its_own_position_not_to_its_index(channels, places):
    frames = noise(32, channels)
    surround = mapped(frames, 6)
    assert [layout(6)[place] for place in places] == list(layout(channels))
    np.testing.assert_array_equal(surround[:, places], frames)
    assert not np.delete(surround, places, axis=1).any()


def test_surround_folds_to_stereo_with_equal_weight_on_both_sides():
    matrix, shared = mapping(6, 2), 0.5**0.5
    np.testing.assert_allclose(matrix[:, 0] / matrix[0, 0], [1, 0, shared, shared, shared, 0])
    np.testing.assert_allclose(matrix[:, 1] / matrix[1, 1], [0, 1, shared, shared, 0, shared])
    assert matrix[:, 0].sum() == pytest.approx(1.0)
