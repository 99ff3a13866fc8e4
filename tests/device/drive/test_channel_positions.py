from dataclasses import replace

import pytest

from device.drive import ActuatorSettings
from device.drive.channel_positions import STREAM_POSITIONS, actuators_of_channels, sink_channel_map
from device.errors import UsageError
from device.server.snapshot import Sink

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
