import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from audioflinger_hook.mixer.layouts import ChannelMap, depths, mapping, source_weights
from audioflinger_hook.mixer.track_mixer import VolumeRamp, gains_of, usable_gain
from audioflinger_hook.transform import HapticTransform
from device.drive import SOURCES, ActuatorSettings
from device.drive.channel_positions import STREAM_POSITIONS, actuators_of_channels, sink_channel_map
from device.errors import UsageError
from device.layouts import CHANNELS_MAX, downmix, layout, sides
from device.server.snapshot import Sink
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
    for names in (("mix",), ("left", "right"), ("front", "back")):
        assert means(channels, names).any(axis=1).all(), "every channel is felt"


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
    matrix = mapping(6, 2)
    np.testing.assert_allclose(matrix[:, 0] / matrix[0, 0], [1, 0, SHARED, SHARED, SHARED, 0])
    np.testing.assert_allclose(matrix[:, 1] / matrix[1, 1], [0, 1, SHARED, SHARED, 0, SHARED])
    assert matrix[:, 0].sum() == pytest.approx(1.0)


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


SURROUND = "front-left,front-right,front-center,lfe,rear-left,rear-right"


def sink(channel_map):
    count = len(channel_map.split(","))
    return Sink(1, "haptic", "", "haptic.monitor", 48_000, count, None, {}, channel_map)


def actuators(*channels):
    return [ActuatorSettings(each) for each in channels]


@pytest.mark.parametrize("channels", STREAM_POSITIONS)
def test_a_sink_in_the_stream_s_own_order_has_its_channels_where_they_are_counted(channels):
    positions = ",".join(STREAM_POSITIONS[channels])
    wanted = actuators(*((channel,) for channel in range(channels)))
    assert sink_channel_map(sink(positions), wanted).sources == tuple(range(channels))


@pytest.mark.parametrize(
    ("channel_map", "channels", "sources"),
    [
        # The third of the sink's channels is the fifth of the stream's, and so on.
        (SURROUND, [(2,), (3,), ("rear-left",)], (None, None, 2, None, 0, 1)),
        (SURROUND, [("lfe", "front-left"), ("rear-right",)], (0, None, None, 1, None, 0)),
        (SURROUND, [(3, 0), (5,)], (0, None, None, 1, None, 0)),
        ("front-right,front-left", [(0,)], (None, 0)),
        # Whatever the positions.
        ("mono", [(0,)], (0,)),
        ("aux0,aux1", [(0, 1)], (0, 0)),
    ],
)
def test_sinks_in_another_order_get_actuators_where_they_count_them(channel_map, channels, sources):
    assert sink_channel_map(sink(channel_map), actuators(*channels)).sources == sources


def test_without_actuators_the_vibration_repeats_over_the_channels_of_any_sink():
    assert sink_channel_map(sink(SURROUND), (), 2).sources == (0, 1, 0, 1, 0, 1)
    assert sink_channel_map(sink("aux0,aux1"), ()).sources == (0, 0)


@pytest.mark.parametrize(
    ("channel_map", "wanted", "words"),
    [
        ("mono", actuators((0,), (1,)), "actuator 2 wants channel 1.*'haptic'.*it has 1, counted"),
        ("mono", actuators(("front-left",)), "channel front-left.*it has mono"),
        ("aux0,aux1", actuators((0,), (1,)), "aux0, aux1, which a stream cannot reach one by one"),
        ("front-left,rear-left", actuators((0,), (1,)), "cannot reach one by one.*hw:CARD"),
    ],
)
def test_what_a_sink_cannot_do_is_said_with_what_helps(channel_map, wanted, words):
    with pytest.raises(UsageError, match=words):
        sink_channel_map(sink(channel_map), wanted)


def of_usb(channel_map, vendor="0x054c", product="0x0ce6"):
    known = {"device.bus": "usb", "device.vendor.id": vendor, "device.product.id": product}
    return replace(sink(channel_map), properties=known)


def test_a_pad_whose_coils_are_known_vibrates_on_their_channels_or_is_refused():
    pad = of_usb("front-left,front-right,rear-left,rear-right")
    for channels in (1, 2):
        sources = None, None, 0, channels - 1
        assert sink_channel_map(pad, (), channels).sources == sources
        assert actuators_of_channels(pad, (), channels).sources == sources
    named = sink_channel_map(pad, actuators((0,)))  # what the user names counts
    assert named.sources == (0, None, None, None)
    other = of_usb("front-left,front-right,rear-left,rear-right", product="0x1234")
    assert sink_channel_map(other, ()).sources == (0, 0, 0, 0)
    with pytest.raises(UsageError, match=r"on channels 2 and 3, .* it has 2 channels"):
        sink_channel_map(of_usb("front-left,front-right"), ())
    with pytest.raises(UsageError, match="cannot reach one by one"):
        sink_channel_map(of_usb("aux0,aux1,aux2,aux3"), ())
