"""Actuators on a sink: its channels go by position, whatever order a stream has them in."""

import pytest

from device.drive import ActuatorSettings
from device.drive.channel_positions import STREAM_POSITIONS, sink_channel_map
from device.errors import UsageError
from device.server.snapshot import Sink

SURROUND = "front-left,front-right,front-center,lfe,rear-left,rear-right"


def sink(channel_map, channels=None):
    count = channels or len(channel_map.split(","))
    return Sink(1, "haptic", "", "haptic.monitor", 48_000, count, None, {}, channel_map)


def actuators(*channels):
    return [ActuatorSettings(each) for each in channels]


@pytest.mark.parametrize("channels", STREAM_POSITIONS)
def test_a_sink_in_the_stream_s_own_order_has_its_channels_where_they_are_counted(channels):
    positions = ",".join(STREAM_POSITIONS[channels])
    wanted = actuators(*((channel,) for channel in range(channels)))
    assert sink_channel_map(sink(positions), wanted).sources == tuple(range(channels))


def test_a_sink_in_another_order_gets_each_actuator_where_it_counts_it():
    # The third of the sink's channels is the fifth of the stream's, and so on.
    found = sink_channel_map(sink(SURROUND), actuators((2,), (3,), ("rear-left",)))
    assert found.sources == (None, None, 2, None, 0, 1)
    swapped = sink_channel_map(sink("front-right,front-left"), actuators((0,)))
    assert swapped.sources == (None, 0)


def test_names_and_numbers_mean_the_same_channels():
    by_name = sink_channel_map(sink(SURROUND), actuators(("lfe", "front-left"), ("rear-right",)))
    assert by_name == sink_channel_map(sink(SURROUND), actuators((3, 0), (5,)))


def test_without_actuators_the_vibration_repeats_over_the_channels_of_any_sink():
    assert sink_channel_map(sink(SURROUND), (), 2).sources == (0, 1, 0, 1, 0, 1)
    assert sink_channel_map(sink("aux0,aux1"), ()).sources == (0, 0)


def test_a_mono_sink_and_one_actuator_everywhere_work_whatever_the_positions():
    assert sink_channel_map(sink("mono"), actuators((0,))).sources == (0,)
    assert sink_channel_map(sink("aux0,aux1"), actuators((0, 1))).sources == (0, 0)


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
