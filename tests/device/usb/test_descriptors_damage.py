"""Descriptors that are damaged: the place and the reason are named, and the rest is read."""

import pytest

from device.usb.descriptors import (
    DescriptorError,
    parse_configuration,
    parse_whole,
    playback_formats,
)
from device.usb.descriptors.reading import parse_device
from tests.support import usb_builder as usb
from tests.support.usb_shapes import SHAPES

STEREO_1 = usb.input_1(1, usb.STREAMING_TERMINAL, 2, 3)
SPEAKER_1 = usb.output_1(3, usb.SPEAKER, 1)
CLOCK = usb.clock_source(9)
STEREO_2 = usb.input_2(1, usb.STREAMING_TERMINAL, 9, 2, 3)
DATA = usb.audio_endpoint_1(1, usb.ISOCHRONOUS | usb.ADAPTIVE, 192)
PCM = usb.format_1(2, 2, 16, [48_000])
UNIT_AT = 9 + 9 + 8 + 1
"""Where the first unit of 1.0 is, behind a header that lists one interface."""
UNIT_2_AT = 9 + 9 + 9


def control_1(*units, lists=(0,)):
    return usb.configuration(usb.control(0, usb.UAC1, usb.header_1(lists, *units)))


def control_2(*units):
    return usb.configuration(usb.control(0, usb.UAC2, usb.header_2(*units)))


def stream_1(*parts, units=(STEREO_1, SPEAKER_1)):
    """A function of 1.0 whose alternate setting has the parts."""
    return usb.configuration(
        usb.control(0, usb.UAC1, usb.header_1([1], *units)),
        usb.streaming(1, 1, usb.UAC1, *parts),
    )


def changed(raw, at, *values):
    assert len(values) <= len(raw) - at
    return raw[:at] + bytes(values) + raw[at + len(values) :]


SETTING_AT = UNIT_AT + len(STEREO_1) + len(SPEAKER_1)
PART_AT = SETTING_AT + 9
GENERAL = usb.general_1(1)
WHOLE = stream_1(GENERAL, PCM, DATA, usb.stream_endpoint_1())
FORMAT_AT = PART_AT + len(GENERAL)
RATES_AT = FORMAT_AT + 7
DATA_AT = FORMAT_AT + len(PCM)
FEATURE = usb.feature_1(2, 1, [1, 2, 2], size=2)

ALL = (2, (1, 3))
"""Channels and path of WHOLE."""

DAMAGE = [
    (
        f"descriptor: bLength is 0, so the last {len(WHOLE) - SETTING_AT} bytes cannot be read",
        SETTING_AT,
        changed(WHOLE, SETTING_AT, 0),
    ),
    (
        "bLength is 5, so the last 1 byte cannot be read",
        11,
        usb.configuration_of(b"\x02\x30\x05", 0),
    ),
    (
        "class-specific endpoint: bLength is 9, but the dump ends after 7 bytes",
        len(WHOLE) - 7,
        changed(WHOLE, len(WHOLE) - 7, 9),
        ALL,
    ),
    (
        f"it has {len(WHOLE)} bytes, but wTotalLength is {len(WHOLE) + 5}: 5 missing",
        0,
        changed(WHOLE, 2, len(WHOLE) + 5, 0),
        ALL,
    ),
    (
        f"but wTotalLength is {len(WHOLE) - 5}: 5 too many",
        0,
        changed(WHOLE, 2, len(WHOLE) - 5, 0),
        ALL,
    ),
    ("configuration: bNumInterfaces is 3, but it has 2", 0, changed(WHOLE, 4, 3), ALL),
    (
        "interface 1.1: bNumEndpoints is 2, but it has 1",
        SETTING_AT,
        changed(WHOLE, SETTING_AT + 4, 2),
        ALL,
    ),
    (
        "interface 4.2: it occurs twice",
        18,
        usb.configuration(*[usb.interface(4, 2, (255, 0, 0))] * 2),
    ),
    (
        "interface: it has 5 bytes, but needs 9; it is ignored",
        9,
        usb.configuration(usb.descriptor(4, b"\x00\x00\x00")),
    ),
    (
        "an association has 2 interfaces from 0 on; possible: 0",
        0,
        usb.configuration(usb.association(0, 2), usb.interface(0, 0, (255, 0, 0))),
    ),
    (
        "endpoint: it has 4 bytes, but needs 7; it is ignored",
        DATA_AT,
        stream_1(GENERAL, PCM, usb.descriptor(5, b"\x81\x01")),
    ),
    ("endpoint: it belongs to no interface", 9, usb.configuration(usb.endpoint(1, 2, 64))),
    (
        "bInterfaceProtocol is 0x44, read as 1.0; known: 0x00 (1.0), 0x20 (2.0) and 0x30 (3.0)",
        SETTING_AT,
        WHOLE.replace(usb.interface(1, 1, (1, 2, 0))[5:], bytes([1, 2, 0x44, 0])),
        ALL,
    ),
    (
        "interface 0.0: it has no audio control header",
        9,
        usb.configuration(usb.control(0, usb.UAC1, STEREO_1)),
    ),
    (
        "audio control header: it has 5 bytes, but needs 8",
        18,
        usb.configuration(usb.control(0, usb.UAC1, usb.class_specific(1, b"\x00\x01"))),
    ),
    (
        "bInCollection is 2, but its length has room for 1",
        18,
        changed(control_1(STEREO_1), 18 + 7, 2),
    ),
    ("interface 0.0: its header lists interface 7, which is missing", 9, control_1(lists=(7,))),
    (
        "input terminal: it has 4 bytes, but needs 12",
        UNIT_AT,
        control_1(usb.class_specific(2, b"\x01")),
    ),
    (
        "output terminal 1: its id occurs twice",
        UNIT_AT + 12,
        control_1(STEREO_1, usb.output_1(1, usb.SPEAKER, 1)),
    ),
    (
        "output terminal 3: source 77 is missing; possible: 1",
        UNIT_AT + 12,
        stream_1(GENERAL, PCM, DATA, units=(STEREO_1, usb.output_1(3, usb.SPEAKER, 77))),
        (2, ()),
    ),
    (
        "output terminal 4: source 3 is missing; possible: 1",
        UNIT_AT + 21,
        control_1(STEREO_1, SPEAKER_1, usb.output_1(4, usb.SPEAKER, 3)),
    ),
    (
        "interface 1.1: no path leads from terminal 1 to an output",
        UNIT_AT + 12 + 14,
        stream_1(
            GENERAL,
            PCM,
            DATA,
            units=(STEREO_1, usb.selector_1(5, [6]), usb.selector_1(6, [5])),
        ),
        (2, ()),
    ),
    (
        "selector unit: bNrInPins is 9, but its length has room for 1; it is ignored",
        UNIT_AT,
        changed(control_1(usb.selector_1(5, [1])), UNIT_AT + 4, 9),
    ),
    (
        "feature unit: bControlSize is 0; its volume and mute are unknown",
        UNIT_AT + 12,
        changed(control_1(STEREO_1, FEATURE), UNIT_AT + 12 + 5, 0),
    ),
    (
        "feature unit: its bit maps of 4 bytes have 10 bytes in all",
        UNIT_2_AT + 8 + 17,
        control_2(CLOCK, STEREO_2, usb.class_specific(6, bytes([2, 1, *[0] * 11]))),
    ),
    ("input terminal 1: clock 9 is missing; possible: none", UNIT_2_AT, control_2(STEREO_2)),
    (
        "clock selector 8: source 1 is missing; possible: 8 or 9",
        UNIT_2_AT + 25,
        control_2(CLOCK, STEREO_2, usb.clock_selector(8, [9, 1])),
    ),
    (
        "interface 1.1: its general descriptor is missing, so it cannot be played",
        SETTING_AT,
        stream_1(PCM, DATA),
    ),
    (
        "interface 1.1: its format descriptor is missing, so it cannot be played",
        SETTING_AT,
        stream_1(GENERAL, DATA),
    ),
    (
        "streaming general: bTerminalLink is 8; terminals: 1 or 3",
        PART_AT,
        stream_1(usb.general_1(8), PCM, DATA),
        (2, ()),
    ),
    (
        "interface 1.1: it has 6 channels, but its terminal has 2",
        SETTING_AT,
        stream_1(GENERAL, usb.format_1(6, 2, 16, [48_000]), DATA),
        (6, (1, 3)),
    ),
    (
        "format type: it has 0 channels",
        FORMAT_AT,
        stream_1(GENERAL, usb.format_1(0, 2, 16, [48_000]), DATA),
    ),
    (
        "16 bits a sample in 9 bytes are impossible",
        FORMAT_AT,
        stream_1(GENERAL, usb.format_1(2, 9, 16, [48_000]), DATA),
        ALL,
    ),
    (
        "24 bits a sample in 2 bytes are impossible",
        FORMAT_AT,
        stream_1(GENERAL, usb.format_1(2, 2, 24, [48_000]), DATA),
        ALL,
    ),
    (
        "bSamFreqType is 4, but its length has room for 1",
        FORMAT_AT,
        changed(WHOLE, RATES_AT, 4),
        ALL,
    ),
    (
        "bSamFreqType is 0 (a range), but its length has no room for two samplerates",
        FORMAT_AT,
        changed(WHOLE, RATES_AT, 0),
        ALL,
    ),
    (
        "a samplerate is 0 Hz",
        FORMAT_AT,
        stream_1(GENERAL, usb.format_1(2, 2, 16, [48_000, 0]), DATA),
        ALL,
    ),
    (
        "samplerates from 48000 to 8000 Hz are impossible",
        FORMAT_AT,
        stream_1(GENERAL, usb.format_1_range(2, 2, 16, 48_000, 8_000), DATA),
        ALL,
    ),
    (
        "endpoint 0x01: its feedback endpoint 0x85 is missing",
        DATA_AT,
        stream_1(GENERAL, PCM, usb.audio_endpoint_1(1, 5, 192, synch=0x85)),
        ALL,
    ),
    (
        "endpoint 0x01: it is interrupt, but sound needs isochronous",
        DATA_AT,
        stream_1(GENERAL, PCM, usb.endpoint(1, 3, 64)),
    ),
]


@pytest.mark.parametrize("damage", DAMAGE, ids=lambda damage: damage[0])
def test_a_problem_names_the_place_and_the_reason_and_the_rest_is_played(damage):
    reason, offset, raw, *plays = damage
    configuration = parse_configuration(raw, begins_at=18)
    found = [p for p in configuration.problems if p.startswith(f"at 0x{offset + 18:04x}, ")]
    assert any(reason in problem for problem in found), configuration.problems
    assert configuration.raw == raw
    assert [(one.channels, one.path) for one in playback_formats(configuration)] == plays


def test_of_samplerates_those_that_are_possible_are_kept():
    for raw in (
        changed(WHOLE, RATES_AT, 4),
        stream_1(GENERAL, usb.format_1(2, 2, 16, [48_000, 0]), DATA),
    ):
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
    for parse in (parse_configuration, parse_whole):
        if raw or parse is parse_configuration:
            with pytest.raises(DescriptorError, match=reason) as caught:
                parse(raw)
            assert caught.value.exit_code == 2


@pytest.mark.parametrize("raw", [b"", usb.device()[:17], changed(usb.device(), 1, 2)])
def test_without_a_device_descriptor_there_is_no_device(raw):
    with pytest.raises(DescriptorError, match="needed: 18 or more, 12 01 first"):
        parse_device(raw)


def test_a_device_says_which_configurations_and_bytes_are_lost():
    whole = parse_whole(usb.device(configurations=2) + WHOLE)
    assert whole.problem == "1 of 2 configurations can be read"
    whole = parse_whole(usb.device() + b"\x09\x04\x00")
    assert whole.problem == (
        "0 of 1 configuration can be read; from 0x0012 on, 3 bytes cannot be read"
    )
    assert whole.rest == b"\x09\x04\x00"
    assert parse_whole(usb.device() + WHOLE).problem == parse_whole(WHOLE).problem == ""


def test_of_very_many_problems_the_first_are_listed_and_the_others_counted():
    raw = usb.configuration_of(usb.descriptor(4, b"") * 1_000, 0)
    problems = parse_configuration(raw).problems
    assert len(problems) == 201
    assert problems[-1] == "800 more problems"
