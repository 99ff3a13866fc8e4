import functools

import pytest

from device.usb.descriptors import RateRange, parse_configuration, parse_whole, playback_formats
from device.usb.descriptors.blocks import DescriptorError
from device.usb.descriptors.configuration import Synchronisation
from device.usb.descriptors.reading import parse_device
from tests.support import usb_builder as usb
from tests.support.usb_shapes import GENERAL_1, PCM_1, SHAPES, SPEAKER_1, STEREO_1, stereo_1


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


CLOCK = usb.clock_source(9)
STEREO_2 = usb.input_2(1, usb.STREAMING_TERMINAL, 9, 2, 3)
FEATURE = usb.feature_1(2, 1, [1, 2, 2], size=2)
FROM_77, FROM_OUTPUT = usb.output_1(3, usb.SPEAKER, 77), usb.output_1(4, usb.SPEAKER, 3)
AGAIN, SELECTOR = usb.output_1(1, usb.SPEAKER, 1), usb.selector_1(5, [1])
SHORT_DATA, SHORT_HEADER = usb.descriptor(5, 0x81, 1), usb.class_specific(1, 0, 1)
SHORT_MAPS = usb.class_specific(6, 2, 1, bytes(11))
OF_CLOCKS = usb.clock_selector(8, [9, 1])
DOWNWARD = usb.format_1_range(2, 2, 16, 48_000, 8_000)
BACK_85 = usb.audio_endpoint_1(1, usb.ASYNCHRONOUS, 192, synch=0x85)


def control(*parts):
    return usb.configuration(usb.control(0, usb.UAC1, *parts))


def control_1(*units, lists=(0,)):
    return control(usb.header_1(lists, *units))


def control_2(*units):
    return usb.configuration(usb.control(0, usb.UAC2, usb.header_2(*units)))


def stream(**parts):
    return stereo_1(SPEAKER_1, **parts)


def formed(channels, subslot, bits, rates=(48_000,)):
    return stream(form=usb.format_1(channels, subslot, bits, rates))


def changed(raw, at, *values):
    assert len(values) <= len(raw) - at
    return raw[:at] + bytes(values) + raw[at + len(values) :]


def in_units(at, value, *units):
    return changed(control_1(*units), at, value)


WHOLE = stream()
in_whole = functools.partial(changed, WHOLE)
SIZE = len(WHOLE)
INTERFACE_AT, HEADER_AT = 9, 9 + 9
UNIT_AT, UNIT_2_AT = HEADER_AT + 9, HEADER_AT + 9
"""Behind a header of 1.0 that lists one interface, and behind one of 2.0."""
SECOND_AT, THIRD_2_AT = UNIT_AT + len(STEREO_1), UNIT_2_AT + len(CLOCK + STEREO_2)
SETTING_AT = SECOND_AT + len(SPEAKER_1)
PART_AT = SETTING_AT + 9
FORMAT_AT = PART_AT + len(GENERAL_1)
RATES_AT = FORMAT_AT + 7
DATA_AT = FORMAT_AT + len(PCM_1)

ALL, NO_PATH = (2, (1, 3)), (2, ())  # of WHOLE; of one whose terminals do not meet
LOOP = stereo_1(usb.selector_1(5, [6]), usb.selector_1(6, [5]))
UNKNOWN = WHOLE.replace(bytes([1, 2, 0, 0, 7, 36]), bytes([1, 2, 0x44, 0, 7, 36]))
TWICE = usb.configuration(*[usb.interface(4, 2, (255, 0, 0))] * 2)
ASSOCIATED = usb.configuration(usb.association(0, 2), usb.interface(0, 0, (255, 0, 0)))

DAMAGE = [
    # reason, place, descriptors; channels and path of what is played nevertheless
    (f"bLength is 0, so the last {SIZE - SETTING_AT} bytes", SETTING_AT, in_whole(SETTING_AT, 0)),
    ("bLength is 5, so the last 1 byte cannot", 11, usb.configuration_of(b"\x02\x30\x05", 0)),
    ("bLength is 9, but the dump ends after 7 bytes", SIZE - 7, in_whole(SIZE - 7, 9), ALL),
    (f"wTotalLength is {SIZE + 5}: 5 missing", 0, in_whole(2, SIZE + 5, 0), ALL),
    (f"wTotalLength is {SIZE - 5}: 5 too many", 0, in_whole(2, SIZE - 5, 0), ALL),
    ("configuration: bNumInterfaces is 3, but it has 2", 0, in_whole(4, 3), ALL),
    ("1.1: bNumEndpoints is 2, but it has 1", SETTING_AT, in_whole(SETTING_AT + 4, 2), ALL),
    ("interface 4.2: it occurs twice", 18, TWICE),
    ("interface: it has 5 bytes, but needs 9", 9, usb.configuration(usb.descriptor(4, bytes(3)))),
    ("an association has 2 interfaces from 0 on; possible: 0", 0, ASSOCIATED),
    ("endpoint: it has 4 bytes, but needs 7", DATA_AT, stream(data=SHORT_DATA)),
    ("endpoint: it belongs to no interface", 9, usb.configuration(usb.endpoint(1, 2, 64))),
    ("is 0x44, read as 1.0; known: 0x00 (1.0), 0x20 (2.0) and 0x30", SETTING_AT, UNKNOWN, ALL),
    ("interface 0.0: it has no audio control header", 9, control(STEREO_1)),
    ("audio control header: it has 5 bytes, but needs 8", HEADER_AT, control(SHORT_HEADER)),
    ("bInCollection is 2, but its length", HEADER_AT, in_units(HEADER_AT + 7, 2, STEREO_1)),
    ("interface 0.0: its header lists interface 7, which is missing", 9, control_1(lists=(7,))),
    ("input terminal: it has 4 bytes", UNIT_AT, control_1(usb.class_specific(2, b"\x01"))),
    ("output terminal 1: its id occurs twice", SECOND_AT, control_1(STEREO_1, AGAIN)),
    ("terminal 3: source 77 is missing; possible: 1", SECOND_AT, stereo_1(FROM_77), NO_PATH),
    ("output terminal 4: source 3 is missing", SETTING_AT, stereo_1(SPEAKER_1, FROM_OUTPUT), ALL),
    ("no path leads from terminal 1 to an output", SECOND_AT + 14, LOOP, NO_PATH),
    ("selector unit: bNrInPins is 9, but its length", UNIT_AT, in_units(UNIT_AT + 4, 9, SELECTOR)),
    ("feature unit: bControlSize is 0", SECOND_AT, in_units(SECOND_AT + 5, 0, STEREO_1, FEATURE)),
    ("feature unit: its bit maps of 4 bytes", THIRD_2_AT, control_2(CLOCK, STEREO_2, SHORT_MAPS)),
    ("input terminal 1: clock 9 is missing; possible: none", UNIT_2_AT, control_2(STEREO_2)),
    ("clock selector 8: source 1 is missing", THIRD_2_AT, control_2(CLOCK, STEREO_2, OF_CLOCKS)),
    ("its general descriptor is missing, so it cannot", SETTING_AT, stream(general=b"")),
    ("its format descriptor is missing, so it cannot be played", SETTING_AT, stream(form=b"")),
    ("bTerminalLink is 8; terminals: 1 or 3", PART_AT, stream(general=usb.general_1(8)), NO_PATH),
    ("it has 6 channels, but its terminal has 2", SETTING_AT, formed(6, 2, 16), (6, (1, 3))),
    ("format type: it has 0 channels", FORMAT_AT, formed(0, 2, 16)),
    ("16 bits a sample in 9 bytes are impossible", FORMAT_AT, formed(2, 9, 16), ALL),
    ("24 bits a sample in 2 bytes are impossible", FORMAT_AT, formed(2, 2, 24), ALL),
    ("is 4, but its length has room for 1", FORMAT_AT, in_whole(RATES_AT, 4), ALL),
    ("a range), but its length has no room for two", FORMAT_AT, in_whole(RATES_AT, 0), ALL),
    ("a samplerate is 0 Hz", FORMAT_AT, formed(2, 2, 16, [48_000, 0]), ALL),
    ("from 48000 to 8000 Hz are impossible", FORMAT_AT, stream(form=DOWNWARD), ALL),
    ("its feedback endpoint 0x85 is missing", DATA_AT, stream(data=BACK_85), ALL),
    ("is interrupt, but sound needs isochronous", DATA_AT, stream(data=usb.endpoint(1, 3, 64))),
]


@pytest.mark.parametrize("damage", DAMAGE, ids=lambda damage: damage[0])
def test_a_problem_names_the_place_and_the_reason_and_the_rest_is_played(damage):
    reason, offset, raw, *plays = damage
    configuration = parse_configuration(raw, begins_at=18)
    found = [p for p in configuration.problems if p.startswith(f"at 0x{offset + 18:04x}, ")]
    assert any(reason in problem for problem in found), configuration.problems
    assert configuration.raw == raw
    assert [(one.channels, one.path) for one in playback_formats(configuration)] == plays


@pytest.mark.parametrize("raw", [in_whole(RATES_AT, 4), formed(2, 2, 16, [48_000, 0])])
def test_of_samplerates_those_that_are_possible_are_kept(raw):
    (only,) = playback_formats(parse_configuration(raw))
    assert only.samplerates == (48_000,)


@pytest.mark.parametrize("shape", SHAPES)
def test_every_beginning_of_a_device_says_how_many_bytes_are_missing(shape):
    raw = SHAPES[shape]
    whole = parse_configuration(raw)
    for length in range(9, len(raw)):
        part = parse_configuration(raw[:length])
        assert part.problems[0].endswith(f": {len(raw) - length} missing")
        numbers = [(one.number, one.alternate) for one in part.interfaces]
        assert numbers == [(one.number, one.alternate) for one in whole.interfaces][: len(numbers)]


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (b"", "no configuration at 0x0000: 0 bytes there, none first"),
        (b"\x09\x02\x20", "3 bytes there, 09 02 first; needed: 9 or more, 09 02 first"),
        (b"\x08\x02" + bytes(7), "9 bytes there, 08 02 first"),
        (b"\x09\x04" + bytes(7), "9 bytes there, 09 04 first"),
    ],
)
def test_without_a_configuration_descriptor_nothing_can_be_read(raw, reason):
    for parse in (parse_configuration, parse_whole) if raw else (parse_configuration,):
        with pytest.raises(DescriptorError, match=reason) as caught:
            parse(raw)
        assert caught.value.exit_code == 2


@pytest.mark.parametrize("raw", [b"", usb.device()[:17], changed(usb.device(), 1, 2)])
def test_without_a_device_descriptor_there_is_no_device(raw):
    with pytest.raises(DescriptorError, match="needed: 18 or more, 12 01 first"):
        parse_device(raw)


def test_a_device_says_what_is_lost_and_of_very_many_problems_the_first_are_listed():
    whole = parse_whole(usb.device(configurations=2) + WHOLE)
    assert whole.problem == "1 of 2 configurations can be read"
    whole = parse_whole(usb.device() + b"\x09\x04\x00")
    lost = "from 0x0012 on, 3 bytes cannot be read"
    assert whole.problem == f"0 of 1 configuration can be read; {lost}"
    assert parse_whole(usb.device() + WHOLE).problem == parse_whole(WHOLE).problem == ""
    problems = parse_configuration(usb.configuration_of(usb.descriptor(4, b"") * 1_000, 0)).problems
    assert (len(problems), problems[-1]) == (201, "800 more problems")
