"""Descriptors that are damaged: the place and the reason are named, and the rest is read."""

import pytest

from device.usb.descriptors import (
    DescriptorError,
    parse_configuration,
    parse_whole,
    playback_formats,
)
from device.usb.descriptors.standard import parse_device
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
DATA_AT = PART_AT + len(GENERAL) + len(PCM)
FEATURE = usb.feature_1(2, 1, [1, 2, 2], size=2)

ALL = (2, (1, 3))
"""Channels and path of WHOLE."""

DAMAGE = {
    "a length of 0": (
        changed(WHOLE, SETTING_AT, 0),
        SETTING_AT,
        f"descriptor: bLength is 0, so the last {len(WHOLE) - SETTING_AT} bytes cannot be read",
        None,
    ),
    "one byte left": (
        usb.configuration_of(b"\x02\x30\x05", 0),
        11,
        "bLength is 5, so the last 1 bytes cannot be read",
        None,
    ),
    "a length beyond the end": (
        changed(WHOLE, len(WHOLE) - 7, 9),
        len(WHOLE) - 7,
        "class-specific endpoint: bLength is 9, but only 7 bytes are left; the end is missing",
        ALL,
    ),
    "bytes that are missing": (
        changed(WHOLE, 2, len(WHOLE) + 5, 0),
        0,
        f"it has {len(WHOLE)} bytes, but wTotalLength is {len(WHOLE) + 5}: 5 are missing",
        ALL,
    ),
    "bytes that are too many": (
        changed(WHOLE, 2, len(WHOLE) - 5, 0),
        0,
        f"but wTotalLength is {len(WHOLE) - 5}: 5 are too many",
        ALL,
    ),
    "a count of interfaces": (
        changed(WHOLE, 4, 3),
        0,
        "configuration: bNumInterfaces is 3, but 2 follow",
        ALL,
    ),
    "a count of endpoints": (
        changed(WHOLE, SETTING_AT + 4, 2),
        SETTING_AT,
        "interface 1.1: bNumEndpoints is 2, but 1 follow",
        ALL,
    ),
    "a setting twice": (
        usb.configuration(*[usb.interface(4, 2, (255, 0, 0))] * 2),
        18,
        "interface 4.2: it occurs twice",
        None,
    ),
    "an interface too short": (
        usb.configuration(usb.descriptor(4, b"\x00\x00\x00")),
        9,
        "interface: it has 5 bytes, but needs 9; it is ignored",
        None,
    ),
    "an association of nothing": (
        usb.configuration(usb.association(0, 2), usb.interface(0, 0, (255, 0, 0))),
        0,
        "an association of 2 interfaces from 0 on spans others than those that follow: 0",
        None,
    ),
    "an endpoint too short": (
        stream_1(GENERAL, PCM, usb.descriptor(5, b"\x81\x01")),
        DATA_AT,
        "endpoint: it has 4 bytes, but needs 7; it is ignored",
        None,
    ),
    "an endpoint outside": (
        usb.configuration(usb.endpoint(1, 2, 64)),
        9,
        "endpoint: it belongs to no interface",
        None,
    ),
    "a protocol that does not exist": (
        WHOLE.replace(usb.interface(1, 1, (1, 2, 0))[5:], bytes([1, 2, 0x44, 0])),
        SETTING_AT,
        "bInterfaceProtocol is 0x44, read as 1.0; known: 0x00 (1.0), 0x20 (2.0) and 0x30 (3.0)",
        ALL,
    ),
    "no header": (
        usb.configuration(usb.control(0, usb.UAC1, STEREO_1)),
        9,
        "interface 0.0: it has no audio control header",
        None,
    ),
    "a header too short": (
        usb.configuration(usb.control(0, usb.UAC1, usb.class_specific(1, b"\x00\x01"))),
        18,
        "audio control header: it has 5 bytes, but needs 8",
        None,
    ),
    "a list that does not fit": (
        changed(control_1(STEREO_1), 18 + 7, 2),
        18,
        "bInCollection is 2, but its length has room for 1",
        None,
    ),
    "a list of a missing interface": (
        control_1(lists=(7,)),
        9,
        "interface 0.0: its header lists interface 7, which is missing",
        None,
    ),
    "a terminal too short": (
        control_1(usb.class_specific(2, b"\x01")),
        UNIT_AT,
        "input terminal: it has 4 bytes, but needs 12",
        None,
    ),
    "an id twice": (
        control_1(STEREO_1, usb.output_1(1, usb.SPEAKER, 1)),
        UNIT_AT + 12,
        "output terminal 1: its id occurs twice",
        None,
    ),
    "a source that is missing": (
        stream_1(GENERAL, PCM, DATA, units=(STEREO_1, usb.output_1(3, usb.SPEAKER, 77))),
        UNIT_AT + 12,
        "output terminal 3: source 77 is missing; possible: 1",
        (2, ()),
    ),
    "a source that only takes": (
        control_1(STEREO_1, SPEAKER_1, usb.output_1(4, usb.SPEAKER, 3)),
        UNIT_AT + 21,
        "output terminal 4: source 3 is missing; possible: 1",
        None,
    ),
    "a circle": (
        stream_1(
            GENERAL,
            PCM,
            DATA,
            units=(STEREO_1, usb.selector_1(5, [6]), usb.selector_1(6, [5])),
        ),
        UNIT_AT + 12 + 14,
        "interface 1.1: no path leads from terminal 1 to an output",
        (2, ()),
    ),
    "pins that do not fit": (
        changed(control_1(usb.selector_1(5, [1])), UNIT_AT + 4, 9),
        UNIT_AT,
        "selector unit: bNrInPins is 9, but its length has room for 1; it is ignored",
        None,
    ),
    "a control size of 0": (
        changed(control_1(STEREO_1, FEATURE), UNIT_AT + 12 + 5, 0),
        UNIT_AT + 12,
        "feature unit: bControlSize is 0; its volume and mute are unknown",
        None,
    ),
    "bit maps that do not fit": (
        control_2(CLOCK, STEREO_2, usb.class_specific(6, bytes([2, 1, *[0] * 11]))),
        UNIT_2_AT + 8 + 17,
        "feature unit: 10 bytes are left for bit maps of 4 bytes each",
        None,
    ),
    "a clock that is missing": (
        control_2(STEREO_2),
        UNIT_2_AT,
        "input terminal 1: clock 9 is missing; possible: none",
        None,
    ),
    "a clock's source": (
        control_2(CLOCK, STEREO_2, usb.clock_selector(8, [9, 1])),
        UNIT_2_AT + 25,
        "clock selector 8: source 1 is missing; possible: 8 or 9",
        None,
    ),
    "a stream without a general": (
        stream_1(PCM, DATA),
        SETTING_AT,
        "interface 1.1: its general descriptor is missing, so it cannot be played",
        None,
    ),
    "a stream without a format": (
        stream_1(GENERAL, DATA),
        SETTING_AT,
        "interface 1.1: its format descriptor is missing, so it cannot be played",
        None,
    ),
    "a link to nowhere": (
        stream_1(usb.general_1(8), PCM, DATA),
        PART_AT,
        "streaming general: bTerminalLink is 8; terminals: 1 or 3",
        (2, ()),
    ),
    "a stream wider than its terminal": (
        stream_1(GENERAL, usb.format_1(6, 2, 16, [48_000]), DATA),
        SETTING_AT,
        "interface 1.1: it has 6 channels, but terminal 1 2",
        (6, (1, 3)),
    ),
    "a format without channels": (
        stream_1(GENERAL, usb.format_1(0, 2, 16, [48_000]), DATA),
        PART_AT + 7,
        "format type: it has 0 channels",
        None,
    ),
    "a subslot of 9 bytes": (
        stream_1(GENERAL, usb.format_1(2, 9, 16, [48_000]), DATA),
        PART_AT + 7,
        "samples of 16 bits in 9 bytes are impossible",
        ALL,
    ),
    "more bits than bytes": (
        stream_1(GENERAL, usb.format_1(2, 2, 24, [48_000]), DATA),
        PART_AT + 7,
        "samples of 24 bits in 2 bytes are impossible",
        ALL,
    ),
    "more rates than fit": (
        changed(WHOLE, PART_AT + 7 + 7, 4),
        PART_AT + 7,
        "bSamFreqType is 4, but its length has room for 1 samplerates",
        ALL,
    ),
    "a range with one end": (
        changed(WHOLE, PART_AT + 7 + 7, 0),
        PART_AT + 7,
        "bSamFreqType is 0 (a range), but its length has no room for two samplerates",
        ALL,
    ),
    "a rate of 0": (
        stream_1(GENERAL, usb.format_1(2, 2, 16, [48_000, 0]), DATA),
        PART_AT + 7,
        "a samplerate is 0 Hz",
        ALL,
    ),
    "a range upside down": (
        stream_1(GENERAL, usb.format_1_range(2, 2, 16, 48_000, 8_000), DATA),
        PART_AT + 7,
        "samplerates from 48000 to 8000 Hz are impossible",
        ALL,
    ),
    "feedback that is missing": (
        stream_1(GENERAL, PCM, usb.audio_endpoint_1(1, 5, 192, synch=0x85)),
        DATA_AT,
        "endpoint 0x01: its feedback endpoint 0x85 is missing",
        ALL,
    ),
    "a stream by interrupts": (
        stream_1(GENERAL, PCM, usb.endpoint(1, 3, 64)),
        DATA_AT,
        "endpoint 0x01: it is interrupt, but sound needs isochronous",
        None,
    ),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_problem_names_the_place_and_the_reason_and_the_rest_is_played(damage):
    raw, offset, reason, plays = DAMAGE[damage]
    configuration = parse_configuration(raw, begins_at=18)
    found = [p for p in configuration.problems if p.startswith(f"at 0x{offset + 18:04x}, ")]
    assert any(reason in problem for problem in found), configuration.problems
    assert configuration.raw == raw
    formats = [(one.channels, one.path) for one in playback_formats(configuration)]
    assert formats == ([plays] if plays else [])


def test_of_samplerates_those_that_are_possible_are_kept():
    for damage in ("more rates than fit", "a rate of 0"):
        (only,) = playback_formats(parse_configuration(DAMAGE[damage][0]))
        assert only.samplerates == (48_000,)


@pytest.mark.parametrize("shape", SHAPES)
def test_every_beginning_of_a_device_says_how_many_bytes_are_missing(shape):
    raw = SHAPES[shape]
    whole = parse_configuration(raw)
    for length in range(9, len(raw)):
        part = parse_configuration(raw[:length])
        assert part.problems[0].endswith(f": {len(raw) - length} are missing")
        numbers = [(one.number, one.alternate) for one in part.interfaces]
        assert numbers == [(one.number, one.alternate) for one in whole.interfaces][: len(numbers)]


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (b"", "the 0 bytes from 0x0000 on begin with nothing"),
        (b"\x09\x02\x20", "the 3 bytes from 0x0000 on begin with 09 02"),
        (b"\x08\x02" + bytes(7), "begin with 08 02; at least 9 that begin with 09 02 are needed"),
        (b"\x09\x04" + bytes(7), "begin with 09 04"),
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
    with pytest.raises(DescriptorError, match="at least 18 that begin with 12 01 are needed"):
        parse_device(raw)


def test_a_device_says_which_configurations_and_bytes_are_lost():
    whole = parse_whole(usb.device(configurations=2) + WHOLE)
    assert whole.problem == "1 of 2 configurations can be read"
    whole = parse_whole(usb.device() + b"\x09\x04\x00")
    assert whole.problem == (
        "0 of 1 configurations can be read; the 3 bytes from 0x0012 on are no configuration"
    )
    assert whole.rest == b"\x09\x04\x00"
    assert parse_whole(usb.device() + WHOLE).problem == parse_whole(WHOLE).problem == ""


def test_of_very_many_problems_the_first_are_listed_and_the_others_counted():
    raw = usb.configuration_of(usb.descriptor(4, b"") * 1_000, 0)
    problems = parse_configuration(raw).problems
    assert len(problems) == 201
    assert problems[-1] == "800 more problems"
