"""Descriptors of devices in the shapes that exist: what is read, and what can be played."""

import pytest

from device.usb.descriptors import RateRange, parse_configuration, parse_whole, playback_formats
from device.usb.descriptors.configuration import Synchronisation
from device.usb.descriptors.reading import parse_device
from tests.support import usb_builder as usb
from tests.support.usb_shapes import GENERAL_1, PCM_1, SHAPES, STEREO_1, stereo_1


def played(raw):
    configuration = parse_configuration(raw)
    assert configuration.problems == ()
    return playback_formats(configuration)


def test_a_device_descriptor_is_read_where_more_follows_and_continuous_rates_are_a_range():
    device = parse_device(usb.device(0x1209, 0xBEEF, usb.IAD) + SHAPES["async_dac"])
    assert (device.vendor_id, device.product_id) == (0x1209, 0xBEEF)
    assert (device.usb, device.release, device.configurations) == (0x0200, 0x0123, 1)
    (only,) = played(SHAPES["continuous_rates"])
    assert (only.samplerates, only.subslot_bytes, only.bits) == (RateRange(8_000, 48_000), 3, 24)
    assert (only.volume_channels, only.mute_channels) == ((0,), (0,))


def test_an_adapter_without_a_master_volume_has_one_for_each_channel_behind_its_mixer():
    (only,) = played(SHAPES["headset_adapter"])
    assert (only.interface, only.alternate, only.uac) == (1, 1, 1)
    assert (only.channels, only.subslot_bytes, only.bits, only.channel_config) == (2, 2, 16, 3)
    assert (only.samplerates, only.clock_id) == ((48_000, 44_100), None)
    assert (only.endpoint_address, only.packet_bytes_max) == (0x01, 200)
    assert only.synchronisation is Synchronisation.ADAPTIVE
    assert (only.feedback_endpoint, only.implicit_feedback) == (None, False)
    assert (only.control_interface, only.path, only.feature_unit) == (0, (1, 15, 9, 6), 9)
    assert (only.volume_channels, only.mute_channels, only.encodings) == ((1, 2), (0,), ("PCM",))


@pytest.mark.parametrize("synch", [0x81, 1], ids=["address", "number without direction"])
def test_eight_channels_have_eight_volumes_and_the_feedback_that_their_endpoint_names(synch):
    raw = SHAPES["eight_channels"].replace(
        usb.audio_endpoint_1(1, 5, 800, synch=0x81), usb.audio_endpoint_1(1, 5, 800, synch=synch)
    )
    eight, two = played(raw)
    assert (eight.channels, two.channels) == (8, 2)
    assert (eight.channel_config, two.channel_config) == (0x063F, 0), "only 8 have positions"
    assert (eight.volume_channels, eight.path) == (tuple(range(1, 9)), (1, 4, 5, 2, 3))
    for each in (eight, two):
        feedback = each.synchronisation, each.feedback_endpoint, each.implicit_feedback
        assert feedback == (Synchronisation.ASYNCHRONOUS, 0x81, False)


def test_the_clock_of_2_0_has_to_be_asked_and_is_found_behind_selector_and_multiplier():
    formats = played(SHAPES["async_dac"])
    widths = [(each.alternate, each.subslot_bytes, each.bits) for each in formats]
    assert widths == [(1, 4, 24), (2, 2, 16), (3, 4, 32)]
    for each in formats:
        assert (each.uac, each.samplerates) == (2, None)
        assert (each.clock_id, each.clock_sources) == (0x2B, (0x29, 0x2A))
        assert (each.feedback_endpoint, each.implicit_feedback) == (0x81, False)
        assert each.path == (2, 10, 20)
        # A volume that can only be read (channel 2) cannot be set.
        assert (each.feature_unit, each.volume_channels, each.mute_channels) == (10, (0, 1), (0,))
    assert formats[2].encodings == ("raw data",)


def test_implicit_feedback_is_the_recording_endpoint_of_the_same_function():
    (only,) = played(SHAPES["implicit_feedback"])
    assert (only.feedback_endpoint, only.implicit_feedback) == (0x83, True)
    assert only.packet_bytes_max == 400, "two transactions of 200 bytes"
    assert (only.channels, only.feature_unit, only.path) == (4, None, (2, 3))


def test_a_function_beside_others_or_midi_is_found_with_every_kind_of_unit_on_the_way():
    (only,) = played(SHAPES["composite"])
    assert (only.interface, only.control_interface) == (2, 1)
    assert only.path == (3, 5, 6, 7, 8, 11, 12, 13)
    assert (only.feature_unit, only.volume_channels) == (12, (1, 2))
    assert only.synchronisation is Synchronisation.SYNCHRONOUS
    (only,) = played(SHAPES["midi_between"])
    assert (only.interface, only.subslot_bytes, only.bits) == (2, 4, 24)


def test_of_3_0_the_streams_are_read_and_no_unit():
    (only,) = played(SHAPES["full_3"])
    assert (only.uac, only.encodings, only.subslot_bytes, only.bits) == (3, ("PCM",), 4, 24)
    assert (only.channels, only.samplerates) == (0, None), "only the device knows"
    assert (only.feature_unit, only.path) == (None, ())


@pytest.mark.parametrize(
    ("packet", "channels", "bits"),
    [(96, 1, 16), (98, 1, 16), (147, 1, 24), (192, 2, 16), (196, 2, 16), (294, 2, 24), (7, 0, 0)],
)
def test_a_basic_profile_of_3_0_has_the_format_that_its_packets_can_hold(packet, channels, bits):
    raw = SHAPES["basic_3"].replace(usb.le(192, 2), usb.le(packet, 2))
    found = [(one.uac, one.channels, one.bits, one.samplerates) for one in played(raw)]
    assert found == [(3, channels, bits, (48_000,))] * bool(channels)


def test_the_active_configuration_counts_and_else_the_first_that_plays():
    hid_only = usb.configuration(usb.interface(0, 0, (3, 0, 0)))
    plays = usb.numbered(SHAPES["headset_adapter"], 2)
    raw = usb.device(configurations=2) + hid_only + plays
    whole = parse_whole(raw)
    assert [one.value for one in whole.configurations] == [1, 2]
    assert (b"".join(one.raw for one in whole.configurations), whole.raw) == (hid_only + plays, raw)
    active = [getattr(whole.active(value), "value", None) for value in (1, 2, None, 7)]
    assert active == [1, 2, 2, 2]
    assert parse_whole(usb.device()).active(1) is None


def test_more_bytes_than_the_standard_has_and_unknown_descriptors_are_no_problem():
    (only,) = played(SHAPES["longer_than_the_standard"])
    assert (only.path, only.packet_bytes_max) == ((1, 2), 200)
    unknown = usb.descriptor(0x77, b"\x01\x02")
    raw = usb.configuration(
        unknown,
        usb.control(0, usb.UAC1, usb.header_1([], usb.class_specific(0x33, b"\x09"))),
        usb.interface(1, 0, (0xFF, 0, 0), usb.endpoint(1, 2, 64), unknown),
        usb.interface(2, 0, (0x02, 2, 0), usb.class_specific(0, b"\x10\x01")),
    )
    assert played(raw) == ()


def test_loudspeakers_come_first_though_farther_and_of_feature_units_the_one_with_a_volume():
    headset, volume = usb.output_1(2, 0x0605, 1), usb.feature_1(3, 1, [0, 2, 2])
    assert played(stereo_1(headset, volume, usb.output_1(4, usb.SPEAKER, 3)))[0].path == (1, 3, 4)
    mute = usb.feature_1(2, 1, [usb.MUTE_1, 0, 0])
    volume = usb.feature_1(3, 2, [usb.VOLUME_1, 0, 0])
    (only,) = played(stereo_1(mute, volume, usb.output_1(4, usb.SPEAKER, 3)))
    assert (only.feature_unit, only.volume_channels, only.mute_channels) == (3, (0,), ())


def test_a_feature_unit_that_leaves_out_its_last_byte_keeps_its_channels():
    whole = usb.feature_1(2, 1, [usb.MUTE_1, usb.VOLUME_1, usb.VOLUME_1], size=2)
    cut = bytes([whole[0] - 1]) + whole[1:-1]
    configuration = parse_configuration(stereo_1(cut, usb.output_1(3, usb.SPEAKER, 2)))
    (only,), (_,) = playback_formats(configuration), configuration.problems
    assert (only.volume_channels, only.mute_channels) == ((1, 2), (0,))


@pytest.mark.parametrize("association", [True, False])
def test_a_midi_function_whose_header_names_the_stream_does_not_take_it(association):
    raw = SHAPES["midi_header_names_the_stream"]
    if not association:  # then a header counts, of the same version
        raw = usb.configuration(*(part for part in usb.split(raw)[1:] if part[1] != 0x0B))
    (playback,) = played(raw)
    assert (playback.clock_id, playback.clock_sources) == (0x29, (0x29,))
    assert (playback.feedback_endpoint, playback.implicit_feedback) == (0x82, True)
    assert (playback.control_interface, playback.feature_unit) == (0, 5)
    assert playback.volume_channels == playback.mute_channels == (0,)


@pytest.mark.parametrize(
    ("associated", "lists"),
    [(True, ([1, 3], [1, 3])), (False, ([1], [3])), (False, ([], []))],
    ids=["both headers list both", "by headers", "by order"],
)
def test_of_two_functions_with_the_same_ids_each_stream_has_its_own_units(associated, lists):
    def one(first, listed, volumes):
        speaker = usb.feature_1(2, 1, volumes), usb.output_1(3, usb.SPEAKER, 2)
        units = usb.header_1(listed, STEREO_1, *speaker)
        data = usb.audio_endpoint_1(first + 1, usb.ADAPTIVE, 192)
        parts = (GENERAL_1, PCM_1, data, usb.stream_endpoint_1())
        stream = usb.streaming(first + 1, 1, usb.UAC1, *parts)
        association = usb.association(first, 2, usb.UAC1) if associated else b""
        return association + usb.control(first, usb.UAC1, units) + stream

    raw = usb.configuration(one(0, lists[0], [2, 0, 0]), one(2, lists[1], [0, 2, 2]))
    found = [(one.control_interface, one.volume_channels) for one in played(raw)]
    assert found == [(0, (0,)), (2, (1, 2))]
