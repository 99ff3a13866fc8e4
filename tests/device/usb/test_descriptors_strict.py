"""Descriptors that lie: strict reading says where and why, forgiving reading what there is."""

import pytest

from device.usb.descriptors import (
    DescriptorError,
    describe,
    parse_configuration,
    parse_device,
    playback_formats,
)
from tests.support import usb_builder as usb
from tests.support.usb_shapes import SHAPES

STEREO_1 = usb.input_1(1, usb.STREAMING_TERMINAL, 2, 3)
SPEAKER_1 = usb.output_1(3, usb.SPEAKER, 1)
CLOCK = usb.clock_source(9)
STEREO_2 = usb.input_2(1, usb.STREAMING_TERMINAL, 9, 2, 3)
SPEAKER_2 = usb.output_2(3, usb.SPEAKER, 1, 9)
DATA = usb.audio_endpoint_1(1, usb.ISOCHRONOUS | usb.ADAPTIVE, 192)
PCM = usb.format_1(2, 2, 16, [48_000])
UNIT_AT = 9 + 9 + 8 + 1
"""Where the first unit of 1.0 stands, behind a header that lists one interface."""
UNIT_2_AT = 9 + 9 + 9


def control_1(*units, lists=(0,)):
    return usb.configuration(usb.control(0, usb.UAC1, usb.header_1(lists, *units)))


def control_2(*units):
    return usb.configuration(usb.control(0, usb.UAC2, usb.header_2(*units)))


def stream_1(*parts):
    """A function of 1.0 whose alternate setting has the parts; the setting stands at 56."""
    units = usb.header_1([1], STEREO_1, SPEAKER_1)
    return usb.configuration(usb.control(0, usb.UAC1, units), usb.streaming(1, 1, usb.UAC1, *parts))


def changed(raw, at, *values):
    assert len(values) <= len(raw) - at
    return raw[:at] + bytes(values) + raw[at + len(values) :]


SETTING_AT = UNIT_AT + len(STEREO_1) + len(SPEAKER_1)
PART_AT = SETTING_AT + 9
GENERAL = usb.general_1(1)
WHOLE = stream_1(GENERAL, PCM, DATA, usb.stream_endpoint_1())
DATA_AT = PART_AT + len(GENERAL) + len(PCM)
FEATURE = usb.feature_1(2, 1, [1, 2, 2], size=2)

MISTAKES = {
    "a length of 0": (
        usb.configuration_of(b"\x00\x04", 0),
        9,
        "bLength is 0; allowed: 2 to 2",
    ),
    "a length of 1": (changed(WHOLE, SETTING_AT, 1), SETTING_AT, "bLength is 1"),
    "a length beyond the end": (
        changed(WHOLE, len(WHOLE) - 7, 9),
        len(WHOLE) - 7,
        "class-specific endpoint: bLength is 9; allowed: 2 to 7",
    ),
    "one byte left": (usb.configuration_of(b"\x02\x30\x05", 0), 11, "1 byte is left"),
    "a total that is too much": (
        changed(WHOLE, 2, 0xFF, 0xFF),
        0,
        f"configuration: wTotalLength is 65535; allowed: {len(WHOLE)}",
    ),
    "a total that is too little": (changed(WHOLE, 2, 20, 0), 0, "wTotalLength is 20"),
    "two configurations": (WHOLE + WHOLE, 0, "where the next configuration"),
    "a count of interfaces": (changed(WHOLE, 4, 3), 0, "bNumInterfaces is 3; allowed: 2"),
    "a count of endpoints": (
        changed(WHOLE, SETTING_AT + 4, 2),
        SETTING_AT,
        "interface 1.1: bNumEndpoints is 2; allowed: 1",
    ),
    "a setting twice": (
        usb.configuration(*[usb.interface(4, 2, (255, 0, 0))] * 2),
        18,
        "interface 4.2: it is there already",
    ),
    "an interface too short": (
        usb.configuration(usb.descriptor(4, b"\x00\x00\x00")),
        9,
        "interface: it is 5 bytes long; allowed: 9 or more",
    ),
    "an association too short": (
        usb.configuration(usb.descriptor(0x0B, b"\x00")),
        9,
        "interface association: it is 3 bytes long; allowed: 8 or more",
    ),
    "an association of nothing": (
        usb.configuration(usb.association(0, 2), usb.interface(0, 0, (255, 0, 0))),
        9,
        "bInterfaceCount is 2 from interface 0 on; allowed: interfaces that are there: 0",
    ),
    "an endpoint too short": (
        usb.configuration(usb.interface(0, 0, (255, 0, 0)), usb.descriptor(5, b"\x81\x01")),
        18,
        "endpoint: it is 4 bytes long; allowed: 7 or more",
    ),
    "an endpoint outside": (
        usb.configuration(usb.endpoint(1, 2, 64)),
        9,
        "endpoint 0x01: it stands outside of any interface",
    ),
    "an endpoint 0": (
        usb.configuration(usb.interface(0, 0, (255, 0, 0), usb.endpoint(0x80, 2, 64))),
        18,
        "bEndpointAddress is 0x80; allowed: a number of 1 to 15",
    ),
    "an interval of 0": (
        changed(WHOLE, DATA_AT + 6, 0),
        DATA_AT,
        "bInterval is 0; allowed: 1 to 16",
    ),
    "a usage that is none": (changed(WHOLE, DATA_AT + 3, 0x35), DATA_AT, "the usage type is 3"),
    "a device within": (
        usb.configuration(usb.device()),
        9,
        "device: it stands within a configuration",
    ),
    "a protocol that is none": (
        usb.configuration(usb.control(0, 0x44, usb.header_1([0]))),
        9,
        "interface 0.0: bInterfaceProtocol is 0x44, read as USB Audio 1.0; allowed: 0x00",
    ),
    "no header": (
        usb.configuration(usb.control(0, usb.UAC1, STEREO_1)),
        9,
        "interface 0.0: no audio control header",
    ),
    "a header too short": (
        usb.configuration(usb.control(0, usb.UAC2, usb.class_specific(1, b"\x00\x02"))),
        18,
        "audio control header: it is 5 bytes long; allowed: 9 or more",
    ),
    "a header of the other version": (
        changed(control_1(), 18 + 4, 2),
        18,
        "bcdADC is 0x0200 in an interface of USB Audio 1.0; allowed: 0x0100",
    ),
    "a header's total": (changed(WHOLE, 18 + 5, 5), 18, "audio control header: wTotalLength is 5"),
    "a collection too long": (
        changed(control_1(STEREO_1), 18 + 7, 2),
        18,
        "bInCollection is 2; allowed: 0 to 1",
    ),
    "a collection of what is not there": (
        control_1(lists=(7,)),
        18,
        "bInCollection lists interface 7; allowed: interfaces that are there: 0",
    ),
    "a terminal too short": (
        control_1(usb.class_specific(2, b"\x01")),
        UNIT_AT,
        "input terminal: it is 4 bytes long; allowed: 12 or more",
    ),
    "an id of 0": (
        control_1(usb.input_1(0, usb.MICROPHONE, 1, 0)),
        UNIT_AT,
        "input terminal 0: its id is 0; allowed: 1 to 255",
    ),
    "an id twice": (
        control_1(STEREO_1, usb.output_1(1, usb.SPEAKER, 1)),
        UNIT_AT + 12,
        "output terminal 1: id 1 is taken already",
    ),
    "a source that is nowhere": (
        control_1(STEREO_1, usb.output_1(3, usb.SPEAKER, 77)),
        UNIT_AT + 12,
        "output terminal 3: source id 77 is of no unit or input terminal; allowed: 1",
    ),
    "a source that takes only": (
        control_1(STEREO_1, SPEAKER_1, usb.output_1(4, usb.SPEAKER, 3)),
        UNIT_AT + 21,
        "output terminal 4: source id 3 is of no unit or input terminal",
    ),
    "a circle": (
        control_1(usb.selector_1(5, [6]), usb.selector_1(6, [7]), usb.selector_1(7, [5])),
        UNIT_AT,
        "selector unit 5: its input comes from itself: 5 from 6 from 7 from 5; allowed: no circle",
    ),
    "a unit of itself": (
        control_1(usb.selector_1(5, [5])),
        UNIT_AT,
        "selector unit 5: its input comes from itself: 5 from 5",
    ),
    "a circle of clocks": (
        control_2(usb.clock_multiplier(1, 2), usb.clock_selector(2, [1])),
        UNIT_2_AT,
        "clock multiplier 1: its input comes from itself",
    ),
    "pins that do not fit": (
        changed(control_1(usb.selector_1(5, [1])), UNIT_AT + 4, 9),
        UNIT_AT,
        "selector unit: bNrInPins is 9; allowed: 0 to 1",
    ),
    "a control size of 0": (
        changed(control_1(STEREO_1, FEATURE), UNIT_AT + 12 + 5, 0),
        UNIT_AT + 12,
        "feature unit: bControlSize is 0; allowed: 1 or more",
    ),
    "a control size that does not fit": (
        changed(control_1(STEREO_1, FEATURE), UNIT_AT + 12 + 5, 4),
        UNIT_AT + 12,
        "bControlSize is 4, and 6 bytes are left for bit maps; allowed: a multiple of 4",
    ),
    "more bit maps than channels": (
        control_1(STEREO_1, usb.feature_1(2, 1, [0, 0, 0, 0])),
        UNIT_AT + 12,
        "feature unit 2: it has bit maps of 4 channels, master included; allowed: 3, since 2",
    ),
    "bit maps of 2.0 that do not fit": (
        control_2(CLOCK, STEREO_2, usb.class_specific(6, bytes([2, 1, *[0] * 11]))),
        UNIT_2_AT + 8 + 17,
        "feature unit: 10 bytes are left for bit maps; allowed: a multiple of 4",
    ),
    "a control that can be written only": (
        control_2(CLOCK, STEREO_2, usb.feature_2(2, 1, [0x8, 0, 0])),
        UNIT_2_AT + 8 + 17,
        "bmaControls(0) is 0x00000008",
    ),
    "a processing unit's control size": (
        changed(control_1(STEREO_1, usb.processing_1(2, 1, [1], 2)), UNIT_AT + 12 + 12, 5),
        UNIT_AT + 12,
        "processing unit: bControlSize is 5; allowed: 0 to 1",
    ),
    "more positions than channels": (
        control_1(usb.input_1(1, usb.MICROPHONE, 1, 7)),
        UNIT_AT,
        "input terminal 1: bNrChannels is 1, with 3 positions; allowed: 3 or more",
    ),
    "a clock that is nowhere": (
        control_2(STEREO_2),
        UNIT_2_AT,
        "input terminal 1: clock id 9 is of no clock; allowed: none",
    ),
    "a clock that is a unit": (
        control_2(CLOCK, STEREO_2, usb.output_2(3, usb.SPEAKER, 1, 1)),
        UNIT_2_AT + 25,
        "output terminal 3: clock id 1 is of no clock; allowed: 9",
    ),
    "a clock's source": (
        control_2(CLOCK, STEREO_2, usb.clock_selector(8, [9, 1])),
        UNIT_2_AT + 25,
        "clock selector 8: source id 1 is of no clock; allowed: 8 or 9",
    ),
    "a converter's clock": (
        control_2(CLOCK, STEREO_2, usb.converter_2(8, 1, 9, 44)),
        UNIT_2_AT + 25,
        "sample rate converter 8: clock id 44 is of no clock",
    ),
    "a stream without a general": (
        stream_1(PCM, DATA),
        SETTING_AT,
        "interface 1.1: it has endpoints and no streaming general",
    ),
    "a stream without a format": (
        stream_1(GENERAL, DATA),
        SETTING_AT,
        "interface 1.1: it has 0 format types that can be read; allowed: one",
    ),
    "a link to nowhere": (
        stream_1(usb.general_1(8), PCM, DATA),
        PART_AT,
        "streaming general: bTerminalLink is 8, which is of no terminal; allowed: 1 or 3",
    ),
    "a stream wider than its terminal": (
        stream_1(GENERAL, usb.format_1(6, 2, 16, [48_000]), DATA),
        SETTING_AT,
        "interface 1.1: its stream has 6 channels, input terminal 1 2; allowed: up to 2",
    ),
    "a format without channels": (
        stream_1(GENERAL, usb.format_1(0, 2, 16, [48_000]), DATA),
        PART_AT + 7,
        "format type I: bNrChannels is 0",
    ),
    "a subslot of 9 bytes": (
        stream_1(GENERAL, usb.format_1(2, 9, 16, [48_000]), DATA),
        PART_AT + 7,
        "bSubframeSize is 9; allowed: 1 to 4 bytes",
    ),
    "more bits than bytes": (
        stream_1(GENERAL, usb.format_1(2, 2, 24, [48_000]), DATA),
        PART_AT + 7,
        "bBitResolution is 24; allowed: 1 to 16 in 2 bytes",
    ),
    "more rates than fit": (
        changed(WHOLE, PART_AT + 7 + 7, 4),
        PART_AT + 7,
        "bSamFreqType is 4; allowed: 1 to 1",
    ),
    "a range with one end": (
        changed(WHOLE, PART_AT + 7 + 7, 0),
        PART_AT + 7,
        "bSamFreqType is 0 (a range), with room for 1 samplerates",
    ),
    "a rate of 0": (
        stream_1(GENERAL, usb.format_1(2, 2, 16, [48_000, 0]), DATA),
        PART_AT + 7,
        "a samplerate of 0 Hz; allowed: 1 Hz or more",
    ),
    "a range upside down": (
        stream_1(GENERAL, usb.format_1_range(2, 2, 16, 48_000, 8_000), DATA),
        PART_AT + 7,
        "samplerates from 48000 to 8000 Hz",
    ),
    "feedback by nobody": (
        stream_1(GENERAL, PCM, usb.audio_endpoint_1(1, 5, 192, synch=0x85)),
        DATA_AT,
        "endpoint 0x01: bSynchAddress is 0x85, which is of no endpoint beside it; allowed: 0x00",
    ),
    "an address twice": (
        stream_1(GENERAL, PCM, DATA, DATA),
        DATA_AT,
        "endpoint 0x01: its address is that of another",
    ),
    "a stream by interrupts": (
        stream_1(GENERAL, PCM, usb.endpoint(1, 3, 64)),
        DATA_AT,
        "endpoint 0x01: it is interrupt; allowed: isochronous",
    ),
    "a class-specific endpoint too early": (
        stream_1(GENERAL, PCM, usb.stream_endpoint_1(), DATA),
        DATA_AT,
        "audio endpoint: it stands before any endpoint",
    ),
    "a class-specific endpoint too short": (
        stream_1(GENERAL, PCM, DATA, usb.descriptor(0x25, b"\x01")),
        DATA_AT + 9,
        "audio endpoint: it is 3 bytes long; allowed: 7 or more",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_strict_reading_names_the_place_and_the_reason(mistake):
    raw, offset, reason = MISTAKES[mistake]
    with pytest.raises(DescriptorError) as caught:
        parse_configuration(raw, strict=True)
    assert str(caught.value).startswith(f"offset {offset}, ")
    assert reason in str(caught.value)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_forgiving_reading_has_the_same_words_among_its_problems(mistake):
    raw, _, _ = MISTAKES[mistake]
    with pytest.raises(DescriptorError) as caught:
        parse_configuration(raw, strict=True)
    configuration = parse_configuration(raw)
    assert str(configuration.problems[0]) == str(caught.value)
    assert f"problem: {caught.value}" in describe(None, configuration)
    assert configuration.raw() == raw


@pytest.mark.parametrize(
    ("mistake", "channels", "path"),
    [
        ("a total that is too much", 2, (1, 3)),
        ("a total that is too little", 2, (1, 3)),
        ("a count of interfaces", 2, (1, 3)),
        ("a count of endpoints", 2, (1, 3)),
        ("a header's total", 2, (1, 3)),
        ("a link to nowhere", 2, ()),
        ("a stream wider than its terminal", 6, (1, 3)),
        ("more rates than fit", 2, (1, 3)),
        ("a range upside down", 2, (1, 3)),
        ("feedback by nobody", 2, (1, 3)),
        ("a class-specific endpoint too early", 2, (1, 3)),
    ],
)
def test_what_can_be_understood_of_a_device_that_lies_can_be_played(mistake, channels, path):
    (only,) = playback_formats(parse_configuration(MISTAKES[mistake][0]))
    assert (only.channels, only.path) == (channels, path)


def test_of_samplerates_that_are_missing_the_others_are_there():
    (only,) = playback_formats(parse_configuration(MISTAKES["more rates than fit"][0]))
    assert only.samplerates == (48_000,)
    (only,) = playback_formats(parse_configuration(MISTAKES["a rate of 0"][0]))
    assert only.samplerates == (48_000,)


@pytest.mark.parametrize("mistake", ["a format without channels", "a stream without a format"])
def test_what_cannot_be_played_is_not_offered(mistake):
    assert playback_formats(parse_configuration(MISTAKES[mistake][0])) == ()


def test_a_length_that_leads_nowhere_ends_the_reading_and_keeps_the_rest():
    raw = changed(WHOLE, SETTING_AT, 0)
    configuration = parse_configuration(raw)
    assert len(configuration.interfaces) == 1
    assert configuration.rest == raw[SETTING_AT:]


@pytest.mark.parametrize("shape", SHAPES)
def test_every_beginning_of_a_device_is_read_as_far_as_it_goes(shape):
    raw = SHAPES[shape]
    whole = parse_configuration(raw)
    for length in range(9, len(raw)):
        part = parse_configuration(raw[:length])
        assert "wTotalLength" in str(part.problems[0])
        read = [d.raw for d in part.descriptors()]
        assert read[:-1] == [d.raw for d in whole.descriptors()][: len(read) - 1]


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (b"", "configuration: bLength is 0 of 0 bytes; allowed: 9 bytes or more"),
        (b"\x09\x02\x20", "bLength is 9 of 3 bytes"),
        (b"\x08\x02" + bytes(7), "bLength is 8 of 9 bytes"),
        (b"\x09\x04" + bytes(7), "bDescriptorType is 0x04; allowed: 0x02"),
        (usb.device() + WHOLE, "leave out the first 18 bytes"),
    ],
)
@pytest.mark.parametrize("strict", [False, True])
def test_without_a_configuration_descriptor_nothing_can_be_read(raw, reason, strict):
    with pytest.raises(DescriptorError, match="offset 0, ") as caught:
        parse_configuration(raw, strict=strict)
    assert reason in str(caught.value)


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (b"", "offset 0, device: bLength is 0 of 0 bytes; allowed: 18 bytes or more"),
        (usb.device()[:17], "bLength is 18 of 17 bytes"),
        (changed(usb.device(), 1, 2), "bDescriptorType is 0x02; allowed: 0x01"),
        (changed(usb.device(), 0, 9), "bLength is 9 of 18 bytes"),
    ],
)
def test_without_a_device_descriptor_there_is_no_device(raw, reason):
    with pytest.raises(DescriptorError) as caught:
        parse_device(raw)
    assert reason in str(caught.value)


def test_of_very_many_problems_the_first_are_told_and_the_others_counted():
    raw = usb.configuration_of(usb.descriptor(4, b"") * 1_000, 0)
    problems = parse_configuration(raw).problems
    assert len(problems) == 201
    assert "800 more problems" in str(problems[-1])
