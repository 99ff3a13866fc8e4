"""What left, right, front and back are made of, and the transform of what they are."""

import numpy as np
import pytest

from audioflinger_hook.mixer.layouts import depths, source_weights
from audioflinger_hook.transform import HapticTransform
from device.drive import SOURCES
from device.errors import UsageError
from device.layouts import CHANNELS_MAX, downmix, layout
from tests.support.taps import noise

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


@pytest.mark.parametrize("channels", range(1, CHANNELS_MAX + 1))
def test_no_place_exceeds_full_scale_and_equal_channels_keep_their_level(channels):
    places = [source for source in SOURCES if source != "mix"]
    found = source_weights(channels, places)
    assert found.shape == (channels, len(places), 2)
    assert (found >= 0.0).all()
    mix = means(channels, ("mix",))
    for column in found.mean(axis=2).T:
        assert column.sum() == pytest.approx(1.0) or np.array_equal(column, mix[:, 0])
    for sides in (("mix",), ("left", "right"), ("front", "back")):
        assert means(channels, sides).any(axis=1).all(), "every channel is felt"


@pytest.mark.parametrize("channels", [1, 2, 3])
def test_without_channels_behind_front_and_back_are_the_mix(channels):
    found = source_weights(channels, ("mix", "front", "back"))
    assert np.array_equal(found, np.stack([downmix(channels)] * 3, axis=1))


def test_of_stereo_four_5_1_and_7_1_each_source_has_its_channels():
    stereo, quad = weights(2, "left", "right"), weights(4, "front", "back")
    assert stereo == {"left": {"FL": 1.0, "FR": 0.0}, "right": {"FL": 0.0, "FR": 1.0}}
    assert quad["front"] == {"FL": 0.5, "FR": 0.5, "BL": 0.0, "BR": 0.0}
    assert quad["back"] == {"FL": 0.0, "FR": 0.0, "BL": 0.5, "BR": 0.5}
    found = weights(6, "left", "back")
    left, back = found["left"], found["back"]
    assert left["FL"] == left["BL"] > 0.0
    assert left["FR"] == left["BR"] == 0.0
    assert left["FC"] == left["LFE"] == pytest.approx(SHARED * left["FL"])
    assert back["BL"] == back["BR"] > 0.0
    assert back["FL"] == back["FR"] == back["FC"] == 0.0
    assert back["LFE"] == pytest.approx(SHARED * back["BL"])
    assert (depths(8), depths(24).count("B")) == ("FFFCBBCC", 6)


def test_no_byte_depends_on_how_the_sound_is_cut_and_unusable_samples_are_counted_once():
    sound = noise(6_000, 6)
    sound[100, 2] = np.nan
    sound[200, 0] = 1e9
    found = source_weights(6, ("mix", "left", "right"))
    whole, parts = (HapticTransform(RATE, 6, weights=found) for _ in range(2))
    expected, cuts = whole.process(sound), np.cumsum([1, 17, 480, 1_000, 3])
    got = np.concatenate([parts.process(part) for part in np.split(sound, cuts)])
    assert got.tobytes() == expected.tobytes()
    assert whole.replaced_samples == parts.replaced_samples == 2
    with pytest.raises(UsageError, match="shape"):
        whole.process(noise(10, 5))
