"""Descriptors of devices in the shapes that exist: what is read, and what can be played."""

import time
from dataclasses import FrozenInstanceError

import pytest

from device.usb.descriptors import (
    DescriptorError,
    RateRange,
    describe,
    parse_configuration,
    parse_device,
    parse_whole,
    playback_formats,
)
from device.usb.descriptors.blocks import OtherDescriptor
from device.usb.descriptors.entities import (
    Access,
    ClockKind,
    ClockSource,
    FeatureControl,
    FeatureUnit,
)
from device.usb.descriptors.names import position_names
from device.usb.descriptors.standard import Endpoint, Synchronisation, Transfer, Usage
from device.usb.descriptors.streaming import AudioEndpoint
from tests.support import usb_builder as usb
from tests.support.usb_shapes import SHAPES


def played(shape):
    return playback_formats(parse_configuration(SHAPES[shape]))


def units_of(configuration, kind):
    entities = [e for interface in configuration.interfaces for e in interface.entities]
    return {entity.id: entity for entity in entities if isinstance(entity, kind)}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_device_without_a_mistake_is_read_alike_either_way(shape):
    strict = parse_configuration(SHAPES[shape], strict=True)
    assert strict == parse_configuration(SHAPES[shape])
    assert strict.problems == ()


@pytest.mark.parametrize("shape", SHAPES)
def test_every_descriptor_keeps_its_place_and_its_bytes(shape):
    raw = SHAPES[shape]
    configuration = parse_configuration(raw)
    assert [d.raw for d in configuration.descriptors()] == usb.split(raw)
    assert all(raw[d.offset :].startswith(d.raw) for d in configuration.descriptors())
    assert configuration.raw() == raw


def test_what_was_read_cannot_be_changed():
    configuration = parse_configuration(SHAPES["async_dac"])
    with pytest.raises(FrozenInstanceError):
        configuration.header.value = 2  # type: ignore[misc]


def test_a_device_descriptor_is_read_even_where_more_follows_it():
    raw = usb.device(0x1209, 0xBEEF, usb.IAD)
    device = parse_device(raw + SHAPES["async_dac"])
    assert (device.vendor_id, device.product_id) == (0x1209, 0xBEEF)
    assert (device.usb, device.release, device.device_class) == (0x0200, 0x0123, 0xEF)
    assert (device.manufacturer_string, device.product_string, device.serial_string) == (1, 2, 3)
    assert (device.control_packet_bytes, device.configurations, device.raw) == (64, 1, raw)


@pytest.mark.parametrize(
    ("attributes", "self_powered", "wakes"),
    [(0x80, False, False), (0xC0, True, False), (0xA0, False, True)],
)
def test_a_configuration_says_whose_power_it_uses_and_how_much(attributes, self_powered, wakes):
    header = parse_configuration(
        usb.configuration(attributes=attributes, units_of_2_ma=250), strict=True
    ).header
    assert (header.self_powered, header.remote_wakeup) == (self_powered, wakes)
    assert header.max_power_ma == 500


# ------------------------------------------------------------------------------------- playing


def test_an_adapter_without_a_master_volume_has_one_for_each_channel_behind_its_mixer():
    (only,) = played("headset_adapter")
    assert (only.interface, only.alternate, only.uac) == (1, 1, 1)
    assert (only.channels, only.subslot_bytes, only.bits) == (2, 2, 16)
    assert position_names(only.channel_config) == ("front-left", "front-right")
    assert (only.samplerates, only.clock_id) == ((48_000, 44_100), None)
    assert (only.endpoint_address, only.packet_bytes_max) == (0x01, 200)
    assert only.synchronisation is Synchronisation.ADAPTIVE
    assert (only.feedback_endpoint, only.implicit_feedback) == (None, False)
    assert (only.control_interface, only.path, only.feature_unit) == (0, (1, 15, 9, 6), 9)
    assert (only.volume_channels, only.mute_channels) == ((1, 2), (0,))
    assert only.encodings == ("PCM",)


def test_continuous_samplerates_are_a_range():
    (only,) = played("continuous_rates")
    assert only.samplerates == RateRange(8_000, 48_000)
    assert (only.subslot_bytes, only.bits) == (3, 24)
    assert (only.volume_channels, only.mute_channels) == ((0,), (0,))


def test_eight_channels_have_eight_volumes_and_their_positions():
    eight, two = played("eight_channels")
    assert (eight.channels, two.channels) == (8, 2)
    assert position_names(eight.channel_config)[-2:] == ("side-left", "side-right")
    assert two.channel_config == 0, "the terminal's positions are those of 8 channels"
    assert eight.volume_channels == tuple(range(1, 9))
    assert eight.path == (1, 4, 5, 2, 3)


def test_feedback_of_1_0_is_found_by_the_address_that_the_data_endpoint_names():
    for found in played("eight_channels"):
        assert found.synchronisation is Synchronisation.ASYNCHRONOUS
        assert (found.feedback_endpoint, found.implicit_feedback) == (0x81, False)


def test_feedback_is_found_though_its_direction_is_left_out():
    raw = SHAPES["eight_channels"].replace(
        usb.audio_endpoint_1(1, 5, 800, synch=0x81), usb.audio_endpoint_1(1, 5, 800, synch=1)
    )
    assert playback_formats(parse_configuration(raw))[0].feedback_endpoint == 0x81


def test_the_clock_of_2_0_has_to_be_asked_and_is_found_behind_selector_and_multiplier():
    formats = played("async_dac")
    assert [(f.alternate, f.subslot_bytes, f.bits) for f in formats] == [
        (1, 4, 24),
        (2, 2, 16),
        (3, 4, 32),
    ]
    for found in formats:
        assert (found.uac, found.samplerates) == (2, None)
        assert (found.clock_id, found.clock_sources) == (0x2B, (0x29, 0x2A))
        assert (found.feedback_endpoint, found.implicit_feedback) == (0x81, False)
        assert found.path == (2, 10, 20)
    assert formats[2].encodings == ("raw data",)


def test_a_volume_that_can_only_be_read_is_none_to_set():
    (first, *_) = played("async_dac")
    assert (first.feature_unit, first.volume_channels, first.mute_channels) == (10, (0, 1), (0,))
    unit = units_of(parse_configuration(SHAPES["async_dac"]), FeatureUnit)[10]
    assert unit.access(2, FeatureControl.VOLUME) is Access.READ_ONLY
    assert unit.access(3, FeatureControl.VOLUME) is Access.ABSENT


def test_implicit_feedback_is_the_recording_endpoint_of_the_same_function():
    (only,) = played("implicit_feedback")
    assert (only.feedback_endpoint, only.implicit_feedback) == (0x83, True)
    assert only.packet_bytes_max == 400, "two transactions of 200 bytes"
    assert (only.channels, only.feature_unit, only.path) == (4, None, (2, 3))


def test_a_function_beside_others_is_found_with_every_kind_of_unit_on_the_way():
    (only,) = played("composite")
    assert (only.interface, only.control_interface) == (2, 1)
    assert only.path == (3, 5, 6, 7, 8, 11, 12, 13)
    assert (only.feature_unit, only.volume_channels) == (12, (1, 2))
    assert only.synchronisation is Synchronisation.SYNCHRONOUS


def test_midi_in_between_is_named_and_changes_nothing():
    configuration = parse_configuration(SHAPES["midi_between"])
    midi = configuration.interfaces[1]
    assert [d.title for d in midi.descriptors] == ["MIDI header", "MIDI in jack"]
    assert [d.title for e in midi.endpoints for d in e.descriptors] == ["MIDI endpoint"]
    (only,) = playback_formats(configuration)
    assert (only.interface, only.subslot_bytes, only.bits) == (2, 4, 24)


def test_units_of_3_0_are_named_and_its_streams_are_read():
    configuration = parse_configuration(SHAPES["full_3"], strict=True)
    assert configuration.uac == 3
    named = [d.title for d in configuration.descriptors() if d.raw[1] == 0x24]
    assert named == ["UAC3 header", "UAC3 feature unit", "UAC3 streaming general"]
    (playback,) = playback_formats(configuration)
    assert (playback.uac, playback.encodings) == (3, ("PCM",))
    assert (playback.subslot_bytes, playback.bits) == (4, 24)
    assert (playback.channels, playback.samplerates) == (0, None)  # the device alone knows
    text = describe(None, configuration)
    assert "terminal 5, PCM, channels of cluster 2, 24 bits in 4 bytes" in text


@pytest.mark.parametrize(
    ("packet", "channels", "bits"),
    [(96, 1, 16), (98, 1, 16), (147, 1, 24), (192, 2, 16), (196, 2, 16), (294, 2, 24), (7, 0, 0)],
)
def test_a_basic_profile_of_3_0_has_the_format_that_its_packets_have_room_for(
    packet, channels, bits
):
    raw = SHAPES["basic_3"].replace(usb.le(192, 2), usb.le(packet, 2))
    configuration = parse_configuration(raw, strict=True)
    found = [
        (one.uac, one.channels, one.bits, one.samplerates)
        for one in playback_formats(configuration)
    ]
    assert found == [(3, channels, bits, (48_000,))] * bool(channels)


def test_the_active_configuration_counts_and_else_the_first_that_plays():
    hid_only = usb.configuration(usb.interface(0, 0, (3, 0, 0)))
    plays = usb.numbered(SHAPES["headset_adapter"], 2)
    whole = parse_whole(usb.device() + hid_only + plays)
    assert [one.header.value for one in whole.configurations] == [1, 2]
    for value, active in ((1, 1), (2, 2), (None, 2), (7, 2)):
        found = whole.active(value)
        assert found is not None
        assert found.header.value == active
    assert parse_whole(usb.device()).active(1) is None


def test_more_bytes_than_the_standard_has_are_kept_and_no_problem():
    configuration = parse_configuration(SHAPES["longer_than_the_standard"], strict=True)
    assert configuration.interfaces[0].raw.endswith(b"\x01\x02\x03")
    (only,) = playback_formats(configuration)
    assert (only.path, only.packet_bytes_max) == ((1, 2), 200)


def test_an_unknown_protocol_is_read_as_1_0():
    raw = SHAPES["continuous_rates"].replace(
        usb.interface(0, 0, (1, 1, 0)), usb.interface(0, 0, (1, 1, 0x55))
    )
    configuration = parse_configuration(raw)
    assert configuration.interfaces[0].uac == 1
    assert playback_formats(configuration) == played("continuous_rates")
    assert "bInterfaceProtocol is 0x55" in str(configuration.problems[0])


def function(*units, terminal=1):
    """1.0 with one alternate setting that plays into a terminal."""
    play = (usb.general_1(terminal), usb.format_1(2, 2, 16, [48_000]))
    data = usb.audio_endpoint_1(1, usb.ISOCHRONOUS | usb.ADAPTIVE, 192)
    return usb.configuration(
        usb.control(0, usb.UAC1, usb.header_1([1], *units)),
        usb.streaming(1, 0, usb.UAC1),
        usb.streaming(1, 1, usb.UAC1, *play, data, usb.stream_endpoint_1()),
    )


def test_loudspeakers_come_before_other_outputs_though_they_are_farther():
    raw = function(
        usb.input_1(1, usb.STREAMING_TERMINAL, 2, 3),
        usb.output_1(2, 0x0605, 1),
        usb.feature_1(3, 1, [0, usb.VOLUME_1, usb.VOLUME_1]),
        usb.output_1(4, usb.SPEAKER, 3),
    )
    assert playback_formats(parse_configuration(raw, strict=True))[0].path == (1, 3, 4)


def test_of_several_feature_units_the_one_with_a_volume_is_taken():
    raw = function(
        usb.input_1(1, usb.STREAMING_TERMINAL, 2, 3),
        usb.feature_1(2, 1, [usb.MUTE_1, 0, 0]),
        usb.feature_1(3, 2, [usb.VOLUME_1, 0, 0]),
        usb.output_1(4, usb.SPEAKER, 3),
    )
    (only,) = playback_formats(parse_configuration(raw, strict=True))
    assert (only.feature_unit, only.volume_channels, only.mute_channels) == (3, (0,), ())


def test_sound_that_only_goes_back_to_the_host_has_no_way_out():
    raw = function(
        usb.input_1(1, usb.STREAMING_TERMINAL, 2, 3), usb.output_1(2, usb.STREAMING_TERMINAL, 1)
    )
    assert playback_formats(parse_configuration(raw, strict=True))[0].path == ()


def test_two_functions_with_the_same_ids_are_kept_apart():
    def one(first, volumes):
        units = usb.header_1(
            [first + 1],
            usb.input_1(1, usb.STREAMING_TERMINAL, 2, 3),
            usb.feature_1(2, 1, volumes),
            usb.output_1(3, usb.SPEAKER, 2),
        )
        data = usb.audio_endpoint_1(first + 1, usb.ISOCHRONOUS | usb.ADAPTIVE, 192)
        play = (usb.general_1(1), usb.format_1(2, 2, 16, [48_000]))
        return (
            usb.control(first, usb.UAC1, units),
            usb.streaming(first + 1, 1, usb.UAC1, *play, data, usb.stream_endpoint_1()),
        )

    raw = usb.configuration(*one(0, [2, 0, 0]), *one(2, [0, 2, 2]))
    first, second = playback_formats(parse_configuration(raw, strict=True))
    assert (first.control_interface, first.volume_channels) == (0, (0,))
    assert (second.control_interface, second.volume_channels) == (2, (1, 2))


# ---------------------------------------------------------------------------------- particulars


def test_a_clock_says_what_it_is_and_what_may_be_done_with_it():
    clocks = units_of(parse_configuration(SHAPES["async_dac"]), ClockSource)
    assert [clocks[i].clock_kind for i in (0x29, 0x2A)] == [
        ClockKind.PROGRAMMABLE,
        ClockKind.EXTERNAL,
    ]
    assert [clocks[i].frequency for i in (0x29, 0x2A)] == [Access.READ_WRITE, Access.READ_ONLY]
    assert units_of(parse_configuration(SHAPES["composite"]), ClockSource)[1].follows_usb_frames


@pytest.mark.parametrize("synchronisation", Synchronisation)
@pytest.mark.parametrize("usage", list(Usage)[:3])
def test_an_isochronous_endpoint_says_whose_clock_it_follows_and_what_it_carries(
    synchronisation, usage
):
    attributes = usb.ISOCHRONOUS | synchronisation << 2 | usage << 4
    raw = usb.configuration(usb.interface(0, 0, (0xFF, 0, 0), usb.endpoint(0x85, attributes, 1024)))
    (endpoint,) = parse_configuration(raw, strict=True).interfaces[0].endpoints
    assert (endpoint.transfer, endpoint.to_host) == (Transfer.ISOCHRONOUS, True)
    assert (endpoint.synchronisation, endpoint.usage) == (synchronisation, usage)
    assert (endpoint.refresh, endpoint.synch_address) == (None, None)


def test_endpoints_of_1_0_say_how_often_feedback_comes_and_whether_a_rate_can_be_set():
    data, synch = parse_configuration(SHAPES["eight_channels"]).interfaces[2].endpoints
    assert (data.synch_address, synch.refresh) == (0x81, 2)
    (side,) = data.descriptors
    assert isinstance(side, AudioEndpoint)
    assert side.samplerate_settable
    assert synch.descriptors == ()


def test_a_feature_unit_that_leaves_out_its_last_byte_keeps_its_channels():
    whole = usb.feature_1(2, 1, [1, 2, 2], size=2)
    cut = bytes([whole[0] - 1]) + whole[1:-1]
    raw = function(
        usb.input_1(1, usb.STREAMING_TERMINAL, 2, 3), cut, usb.output_1(3, usb.SPEAKER, 2)
    )
    configuration = parse_configuration(raw)
    assert units_of(configuration, FeatureUnit)[2].controls == (1, 2, 2)
    assert len(configuration.problems) == 1


def test_a_class_specific_endpoint_that_comes_too_early_belongs_to_the_next_endpoint():
    whole = SHAPES["longer_than_the_standard"]
    late = b"".join(usb.split(whole)[-2:])
    raw = whole.replace(late, usb.stream_endpoint_1(extra=b"\x77") + usb.split(late)[0])
    configuration = parse_configuration(raw)
    (endpoint,) = configuration.interfaces[-1].endpoints
    side = endpoint.descriptors[0]
    assert isinstance(side, AudioEndpoint)
    assert side.samplerate_settable
    assert "stands before any endpoint" in str(configuration.problems[0])


def test_unknown_descriptors_are_kept_wherever_they_stand():
    unknown = usb.descriptor(0x77, b"\x01\x02")
    raw = usb.configuration(
        unknown,
        usb.control(0, usb.UAC1, usb.header_1([], usb.class_specific(0x33, b"\x09"))),
        usb.interface(1, 0, (0xFF, 0, 0), usb.endpoint(1, 2, 64), unknown),
        usb.interface(2, 0, (0x02, 2, 0), usb.class_specific(0, b"\x10\x01")),
    )
    configuration = parse_configuration(raw, strict=True)
    others = [d for d in configuration.descriptors() if isinstance(d, OtherDescriptor)]
    assert [other.title for other in others] == [
        "type 0x77",
        "UAC1 audio control subtype 0x33",
        "type 0x77",
        "communications subtype 0x00",
    ]


# ------------------------------------------------------------------------------------- functions


@pytest.mark.parametrize("association", [True, False])
def test_a_midi_function_whose_header_names_the_stream_does_not_take_it(association):
    raw = SHAPES["midi_header_names_the_stream"]
    if not association:  # then a header counts, of the same version
        raw = usb.configuration(*(part for part in usb.split(raw)[1:] if part[1] != 0x0B))
    (playback,) = playback_formats(parse_configuration(raw))
    assert (playback.clock_id, playback.clock_sources) == (0x29, (0x29,))
    assert (playback.feedback_endpoint, playback.implicit_feedback) == (0x82, True)
    assert (playback.control_interface, playback.feature_unit) == (0, 5)
    assert playback.volume_channels == playback.mute_channels == (0,)


def test_of_two_functions_each_stream_has_its_own_units_whatever_the_headers_list():
    def function(first, volume):
        units = usb.header_1(
            [1, 3],  # both list both streams
            usb.input_1(1, usb.STREAMING_TERMINAL, 2, 3),
            usb.feature_1(volume, 1, [usb.VOLUME_1, 0, 0]),
            usb.output_1(3, usb.SPEAKER, volume),
        )
        data = usb.audio_endpoint_1(first + 1, usb.ISOCHRONOUS | usb.ADAPTIVE, 200)
        play = (usb.general_1(1), usb.format_1(2, 2, 16, [48_000]), data, usb.stream_endpoint_1())
        return (
            usb.association(first, 2, usb.UAC1),
            usb.control(first, usb.UAC1, units),
            usb.streaming(first + 1, 0, usb.UAC1),
            usb.streaming(first + 1, 1, usb.UAC1, *play),
        )

    raw = usb.configuration(*function(0, 7), *function(2, 9))
    found = playback_formats(parse_configuration(raw))
    assert [(one.interface, one.control_interface, one.feature_unit) for one in found] == [
        (1, 0, 7),
        (3, 2, 9),
    ]


def interrupt_and_stream(*more):
    """An interface with an interrupt and an isochronous endpoint of intervals 4 and 3."""
    return parse_configuration(
        usb.configuration(
            usb.interface(0, 0, (3, 0, 0), usb.endpoint(0x81, 3, 8, 4), *more),
            usb.streaming(1, 1, usb.UAC2, usb.endpoint(1, 5, 64, 3)),
        )
    )


BULK_512, BULK_64 = usb.endpoint(2, 2, 512, 0), usb.endpoint(2, 2, 64, 0)
COMPANION = usb.descriptor(0x30, bytes(4))


@pytest.mark.parametrize(
    ("device", "more", "speed", "told"),
    [
        (None, (), 480.0, ["1000 us", "500 us"]),
        (None, (), 12.0, ["4000 us", "4000 us"]),
        (usb.device(usb=0x0110), (), 0.0, ["4000 us", "4000 us"]),
        (None, (BULK_512,), 0.0, ["1000 us", "500 us"]),
        (None, (BULK_64,), 0.0, ["4000 us", "4000 us"]),
        (None, (COMPANION,), 0.0, ["1000 us", "500 us"]),
        (None, (), 0.0, ["1000 us, or 4000 us at full speed", "500 us, or 4000 us at full speed"]),
    ],
)
def test_intervals_are_told_in_microseconds_as_the_speed_has_them(device, more, speed, told):
    parsed = parse_device(device) if device else None
    lines = describe(parsed, interrupt_and_stream(*more), speed).splitlines()
    found = [line.partition(", interval ")[2] for line in lines if "endpoint 0x" in line]
    timed = [each for each in found if each and "us" in each]
    assert timed == [f"4 ({told[0]})", f"3 ({told[1]})"]
    if BULK_512 in more:
        assert "0" in found  # a bulk endpoint has no interval


def test_power_at_superspeed_is_in_units_of_8_ma():
    assert interrupt_and_stream(COMPANION).header.max_power_ma == 400
    assert interrupt_and_stream().header.max_power_ma == 100


# ------------------------------------------------------------------------------------------ time


def best_of(times, raw):
    """Seconds of the quickest, which the rest of the machine disturbed least."""
    found = []
    for _ in range(times):
        before = time.perf_counter()
        parse_configuration(raw)
        found.append(time.perf_counter() - before)
    return min(found)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_device_is_read_in_less_than_a_millisecond(shape):
    assert best_of(50, SHAPES[shape]) < 1e-3


@pytest.mark.sweep
@pytest.mark.parametrize(
    "part",
    [
        usb.descriptor(0x24, b""),
        usb.association(0, 255),
        usb.endpoint(1, 5, 192),
        usb.interface(0, 0, (1, 1, 0)),
        usb.class_specific(1, bytes([0, 1, 0, 0, 60, *range(60)])),
    ],
    ids=["class specific", "association", "endpoint", "interface", "header"],
)
def test_eight_times_the_bytes_take_about_eight_times_as_long(part):
    def of(count):
        return usb.configuration_of(usb.control(0, usb.UAC1, usb.header_1([])) + part * count, 1)

    count = 4_000 // len(part)
    # 64 would be quadratic; between them is room for what a busy machine adds.
    assert best_of(5, of(8 * count)) < 24 * best_of(5, of(count))


def test_an_endpoint_is_hashable_so_that_it_may_be_a_key():
    endpoints = parse_configuration(SHAPES["async_dac"]).interfaces[3].endpoints
    assert {endpoint: endpoint.address for endpoint in endpoints}[endpoints[0]] == 0x01
    assert all(isinstance(endpoint, Endpoint) for endpoint in endpoints)


def test_an_error_is_the_users_to_put_right():
    with pytest.raises(DescriptorError) as caught:
        parse_configuration(b"")
    assert caught.value.exit_code == 2
