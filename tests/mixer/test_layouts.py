"""What left, right, front and back are made of, and the transform of what they are."""

import numpy as np
import pytest

from audioflinger_hook.mixer.layouts import depths, source_weights
from audioflinger_hook.transform import HapticTransform
from device.drive import SOURCES
from device.errors import UsageError
from device.layouts import CHANNELS_MAX, downmix, layout

RATE = 8_000
SHARED = 0.5**0.5


def means(channels, sources):
    """Return the weights of the sources themselves, which are the means of their halves."""
    return source_weights(channels, sources).mean(axis=2)


def weights(channels, *sources):
    return {
        source: dict(zip(layout(channels), column, strict=True))
        for source, column in zip(sources, means(channels, sources).T, strict=True)
    }


def noise(frames, channels, seed=1):
    values = np.random.default_rng(seed).uniform(-0.5, 0.5, (frames, channels))
    return values.astype(np.float32)


@pytest.mark.parametrize("channels", range(1, CHANNELS_MAX + 1))
def test_no_place_exceeds_full_scale_and_equal_channels_keep_their_level(channels):
    places = [source for source in SOURCES if source != "mix"]
    found = source_weights(channels, places)
    assert found.shape == (channels, len(places), 2)
    assert (found >= 0.0).all()
    mix = means(channels, ("mix",))
    for column in found.mean(axis=2).T:
        assert column.sum() == pytest.approx(1.0) or np.array_equal(column, mix[:, 0])


@pytest.mark.parametrize("channels", range(1, CHANNELS_MAX + 1))
def test_every_channel_is_felt_on_one_side_at_least(channels):
    for sources in (("mix",), ("left", "right"), ("front", "back")):
        assert means(channels, sources).any(axis=1).all()


def test_of_stereo_left_and_right_are_the_channels_themselves():
    assert weights(2, "left", "right") == {
        "left": {"FL": 1.0, "FR": 0.0},
        "right": {"FL": 0.0, "FR": 1.0},
    }


@pytest.mark.parametrize("channels", [1, 2, 3])
def test_without_channels_behind_front_and_back_are_the_mix(channels):
    found = source_weights(channels, ("mix", "front", "back"))
    assert np.array_equal(found, np.stack([downmix(channels)] * 3, axis=1))


def test_of_four_channels_back_is_those_behind():
    found = weights(4, "front", "back")
    assert found["front"] == {"FL": 0.5, "FR": 0.5, "BL": 0.0, "BR": 0.0}
    assert found["back"] == {"FL": 0.0, "FR": 0.0, "BL": 0.5, "BR": 0.5}


def test_of_5_1_the_centre_is_on_both_sides_and_the_bass_before_and_behind():
    found = weights(6, "left", "back")
    left, back = found["left"], found["back"]
    assert left["FL"] == left["BL"] > 0.0
    assert left["FR"] == left["BR"] == 0.0
    assert left["FC"] == left["LFE"] == pytest.approx(SHARED * left["FL"])
    assert back["BL"] == back["BR"] > 0.0
    assert back["FL"] == back["FR"] == back["FC"] == 0.0
    assert back["LFE"] == pytest.approx(SHARED * back["BL"])


def test_of_7_1_the_sides_are_before_and_behind():
    assert depths(8) == "FFFCBBCC"
    assert depths(24).count("B") == 6


def test_each_source_is_transformed_by_itself():
    sound = noise(6_000, 4)
    found = source_weights(4, ("left", "back"))
    transform = HapticTransform(RATE, 4, weights=found)
    assert transform.channels_out == 2
    both = np.concatenate([transform.process(sound), transform.finish()])
    for column, mixed in enumerate((0.5 * (sound[:, 0] + sound[:, 2]), sound[:, 2:].mean(axis=1))):
        alone = HapticTransform(RATE, 1)
        wanted = np.concatenate([alone.process(mixed.astype(np.float64)), alone.finish()])
        # The sum was made in float64 there and in float32 here: 6e-8 of full scale, then bands
        # of it beside each other.
        np.testing.assert_allclose(both[:, column], wanted[:, 0], atol=1e-5)


def test_no_byte_depends_on_how_the_sound_is_cut_and_unusable_samples_are_counted_once():
    sound = noise(6_000, 6)
    sound[100, 2] = np.nan
    sound[200, 0] = 1e9
    found = source_weights(6, ("mix", "left", "right"))
    whole, parts = (HapticTransform(RATE, 6, weights=found) for _ in range(2))
    expected = whole.process(sound)
    cuts = np.cumsum([1, 17, 480, 1_000, 3])
    got = np.concatenate([parts.process(part) for part in np.split(sound, cuts)])
    assert got.tobytes() == expected.tobytes()
    assert whole.replaced_samples == parts.replaced_samples == 2
    with pytest.raises(UsageError, match="shape"):
        whole.process(noise(10, 5))
