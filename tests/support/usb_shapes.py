"""Configurations in the shapes of real devices, each without a mistake."""

from __future__ import annotations

from tests.support.usb_builder import (
    ADAPTIVE,
    ASYNCHRONOUS,
    FEEDBACK,
    HEADPHONES,
    HID,
    IMPLICIT,
    ISOCHRONOUS,
    MICROPHONE,
    MUTE_1,
    MUTE_2,
    SPEAKER,
    STREAMING_TERMINAL,
    SYNCHRONOUS,
    UAC1,
    UAC2,
    UAC3,
    VOLUME_1,
    VOLUME_2,
    VOLUME_2_READ,
    association,
    audio_endpoint_1,
    class_specific,
    clock_multiplier,
    clock_selector,
    clock_source,
    configuration,
    control,
    converter_2,
    descriptor,
    effect_2,
    endpoint,
    extension_2,
    feature_1,
    feature_2,
    format_1,
    format_1_range,
    format_2,
    general_1,
    general_2,
    header_1,
    header_2,
    input_1,
    input_2,
    interface,
    le,
    mixer_1,
    mixer_2,
    output_1,
    output_2,
    processing_1,
    processing_2,
    selector_1,
    selector_2,
    stream_endpoint_1,
    stream_endpoint_2,
    streaming,
)

STEREO = 0x3


def hid(number: int, address: int) -> bytes:
    """The volume keys that most adapters have."""
    report = descriptor(0x21, le(0x0111, 2) + bytes([0, 1, 0x22]) + le(60, 2))
    return interface(number, 0, (HID, 0, 0), report, endpoint(address, 0x03, 4, 8))


def headset_adapter() -> bytes:
    """1.0, stereo out and a microphone; the feature unit 9 has no master volume, ids as they fall.

    The microphone is also mixed into the headphones (13 into 15), past a second feature unit.
    """
    units = header_1(
        [1, 2],
        input_1(1, STREAMING_TERMINAL, 2, STEREO),
        input_1(2, MICROPHONE, 1, 0),
        output_1(6, HEADPHONES, 9),
        output_1(7, STREAMING_TERMINAL, 8),
        selector_1(8, [10]),
        feature_1(9, 15, [MUTE_1, VOLUME_1, VOLUME_1]),
        feature_1(10, 2, [MUTE_1 | VOLUME_1, 0]),
        feature_1(13, 2, [MUTE_1 | VOLUME_1, 0]),
        mixer_1(15, [1, 13], 2, STEREO),
    )
    play = (general_1(1), format_1(2, 2, 16, [48_000, 44_100]))
    record = (general_1(7), format_1(1, 2, 16, [48_000]))
    return configuration(
        control(0, UAC1, units),
        streaming(1, 0, UAC1),
        streaming(
            1, 1, UAC1, *play, audio_endpoint_1(1, ISOCHRONOUS | ADAPTIVE, 200), stream_endpoint_1()
        ),
        streaming(2, 0, UAC1),
        streaming(
            2,
            1,
            UAC1,
            *record,
            audio_endpoint_1(0x82, ISOCHRONOUS | ASYNCHRONOUS, 100),
            stream_endpoint_1(),
        ),
        hid(3, 0x87),
        units_of_2_ma=50,
    )


def continuous_rates() -> bytes:
    """1.0, adaptive, any samplerate from 8 to 48 kHz; 24 bits in 3 bytes; a master volume only."""
    units = header_1(
        [1],
        input_1(1, STREAMING_TERMINAL, 2, STEREO),
        feature_1(2, 1, [MUTE_1 | VOLUME_1, 0, 0], size=2),
        output_1(3, SPEAKER, 2),
    )
    play = (general_1(1), format_1_range(2, 3, 24, 8_000, 48_000))
    attributes = ISOCHRONOUS | ADAPTIVE
    return configuration(
        control(0, UAC1, units),
        streaming(1, 0, UAC1),
        streaming(1, 1, UAC1, *play, audio_endpoint_1(2, attributes, 294), stream_endpoint_1()),
        attributes=0xC0,
        units_of_2_ma=0,
    )


def eight_channels() -> bytes:
    """1.0, 8 and 2 channels, asynchronous with feedback that only bSynchAddress names."""
    units = header_1(
        [1],
        input_1(1, STREAMING_TERMINAL, 8, 0x063F),
        processing_1(4, 1, [1], 8),
        processing_1(5, 0x1234, [4], 8, subtype=8),
        feature_1(2, 5, [MUTE_1, *[VOLUME_1] * 8]),
        output_1(3, SPEAKER, 2),
    )
    synch = audio_endpoint_1(0x81, ISOCHRONOUS, 3, refresh=2)

    def alternate(number: int, channels: int) -> bytes:
        data = audio_endpoint_1(1, ISOCHRONOUS | ASYNCHRONOUS, 100 * channels, synch=0x81)
        form = format_1(channels, 2, 16, [44_100, 48_000])
        return streaming(1, number, UAC1, general_1(1), form, data, stream_endpoint_1(), synch)

    return configuration(
        control(0, UAC1, units), streaming(1, 0, UAC1), alternate(1, 8), alternate(2, 2)
    )


def async_dac() -> bytes:
    """2.0, a clock behind a selector and a multiplier, explicit feedback; 24 in 4, 16 in 2, DSD."""
    units = header_2(
        clock_source(0x29, 3, 7),
        clock_source(0x2A, 0, 5),
        clock_selector(0x28, [0x29, 0x2A]),
        clock_multiplier(0x2B, 0x28),
        input_2(2, STREAMING_TERMINAL, 0x2B, 2, STEREO),
        feature_2(10, 2, [MUTE_2 | VOLUME_2, VOLUME_2, VOLUME_2_READ]),
        output_2(20, SPEAKER, 10, 0x2B),
    )
    feedback = endpoint(0x81, ISOCHRONOUS | FEEDBACK, 4, 4)

    def alternate(number: int, subslot: int, bits: int, formats: int = 1) -> bytes:
        data = endpoint(1, ISOCHRONOUS | ASYNCHRONOUS, 24 * subslot + 8)
        general = general_2(2, 2, STEREO, formats)
        form = format_2(subslot, bits)
        return streaming(1, number, UAC2, general, form, data, stream_endpoint_2(), feedback)

    return configuration(
        association(0, 2),
        control(0, UAC2, units),
        streaming(1, 0, UAC2),
        alternate(1, 4, 24),
        alternate(2, 2, 16),
        alternate(3, 4, 32, formats=1 << 31),
        interface(2, 0, (0xFE, 1, 1), descriptor(0x21, bytes([0x0B, 0xFA, 0, 0x40, 0, 0x10, 1]))),
        attributes=0xC0,
    )


def implicit_feedback() -> bytes:
    """2.0 interface with 4 channels each way: the recording endpoint tells how fast it plays."""
    units = header_2(
        clock_source(1, 1, 1),
        input_2(2, STREAMING_TERMINAL, 1, 4, 0),
        output_2(3, SPEAKER, 2, 1),
        input_2(4, MICROPHONE, 1, 4, 0),
        output_2(5, STREAMING_TERMINAL, 4, 1),
    )
    out = endpoint(0x03, ISOCHRONOUS | ASYNCHRONOUS, 0x0800 | 200)
    back = endpoint(0x83, ISOCHRONOUS | ASYNCHRONOUS | IMPLICIT, 112)
    form = format_2(4, 24)
    return configuration(
        association(0, 3),
        control(0, UAC2, units),
        streaming(1, 0, UAC2),
        streaming(1, 1, UAC2, general_2(2, 4, 0), form, out, stream_endpoint_2()),
        streaming(2, 0, UAC2),
        streaming(2, 1, UAC2, general_2(5, 4, 0), form, back, stream_endpoint_2()),
    )


def composite() -> bytes:
    """HID first, then 2.0 as the function of interfaces 1 and 2, with every kind of unit."""
    units = header_2(
        clock_source(1, 5, 3),
        clock_source(2, 1, 1),
        input_2(3, STREAMING_TERMINAL, 1, 2, STEREO),
        input_2(4, MICROPHONE, 1, 2, STEREO),
        converter_2(5, 3, 1, 2),
        effect_2(6, 5, 2),
        processing_2(7, [6], 2),
        extension_2(8, [7], 2),
        mixer_2(9, [8, 4], 2, STEREO),
        selector_2(11, [9, 8]),
        feature_2(12, 11, [MUTE_2, VOLUME_2, VOLUME_2]),
        output_2(13, HEADPHONES, 12, 2),
    )
    data = endpoint(4, ISOCHRONOUS | SYNCHRONOUS, 192)
    general = general_2(3, 2, STEREO)
    return configuration(
        hid(0, 0x81),
        association(1, 2),
        control(1, UAC2, units),
        streaming(2, 0, UAC2),
        streaming(2, 1, UAC2, general, format_2(2, 16), data, stream_endpoint_2()),
        descriptor(0x41, b"\xca\xfe"),
    )


def midi_between() -> bytes:
    """1.0, with MIDI jacks between the control interface and the streaming one; 24 bits in 4."""
    units = header_1([1, 2], input_1(1, STREAMING_TERMINAL, 2, STEREO), output_1(2, SPEAKER, 1))
    midi = interface(
        1,
        0,
        (0x01, 3, 0),
        class_specific(1, le(0x0100, 2) + le(13, 2)),
        class_specific(2, bytes([1, 1, 0])),
        descriptor(5, bytes([0x02, 2]) + le(64, 2) + bytes([0, 0, 0])),
        descriptor(0x25, bytes([1, 1, 1])),
    )
    data = audio_endpoint_1(1, ISOCHRONOUS | ADAPTIVE, 392)
    play = (general_1(1), format_1(2, 4, 24, [96_000]))
    return configuration(
        control(0, UAC1, units),
        midi,
        streaming(2, 0, UAC1),
        streaming(2, 1, UAC1, *play, data, stream_endpoint_1()),
    )


def midi_header_names_the_stream() -> bytes:
    """2.0 with implicit feedback and a volume, and a MIDI function whose header lists interface 1.

    As SSL 2+ (31e9:0002) and Behringer WING. The association spans interfaces 0 to 2 alone.
    """
    units = header_2(
        clock_source(0x29),
        input_2(1, STREAMING_TERMINAL, 0x29, 4, 0),
        feature_2(5, 1, [MUTE_2 | VOLUME_2, 0, 0, 0, 0]),
        output_2(2, SPEAKER, 5, 0x29),
        input_2(3, MICROPHONE, 0x29, 2, 0),
        output_2(4, STREAMING_TERMINAL, 3, 0x29),
    )
    out = endpoint(0x01, ISOCHRONOUS | ASYNCHRONOUS, 112)
    back = endpoint(0x82, ISOCHRONOUS | ASYNCHRONOUS | IMPLICIT, 56)
    form = format_2(4, 24)
    midi = interface(
        4,
        0,
        (0x01, 3, 0),
        class_specific(1, le(0x0100, 2) + le(13, 2)),
        class_specific(2, bytes([1, 1, 0])),
        descriptor(5, bytes([0x03, 2]) + le(512, 2) + bytes([0, 0, 0])),
        descriptor(0x25, bytes([1, 1, 1])),
    )
    return configuration(
        association(0, 3),
        control(0, UAC2, units),
        streaming(1, 0, UAC2),
        streaming(1, 1, UAC2, general_2(1, 4, 0), form, out, stream_endpoint_2()),
        streaming(2, 0, UAC2),
        streaming(2, 1, UAC2, general_2(4, 2, 0), form, back, stream_endpoint_2()),
        control(3, UAC1, header_1([1])),
        midi,
    )


def basic_3() -> bytes:
    """3.0 with a basic profile: no unit is described."""
    return configuration(
        association(0, 2, UAC3),
        control(0, UAC3),
        streaming(1, 0, UAC3),
        streaming(1, 1, UAC3, endpoint(1, ISOCHRONOUS | ADAPTIVE, 192)),
    )


def full_3() -> bytes:
    """3.0 with units, which are named and not understood; 24 bits in 4 bytes."""
    units = class_specific(1, bytes([8]) + le(0x28, 2) + bytes(4)) + class_specific(7, bytes(20))
    play = class_specific(1, bytes([5, *bytes(4), 2, 0, 1, *bytes(7), 4, 24, 0, 0, 4]))
    return configuration(
        association(0, 2, UAC3),
        control(0, UAC3, units),
        streaming(1, 0, UAC3),
        streaming(1, 1, UAC3, play, endpoint(1, ISOCHRONOUS | ADAPTIVE, 192)),
    )


def longer_than_the_standard() -> bytes:
    """1.0 whose interface, terminal and endpoint descriptors have bytes that nobody knows."""
    units = header_1(
        [1],
        class_specific(2, bytes([1, 1, 1, 0, 2, 3, 0, 0, 0]), extra=b"\xaa\xbb"),
        class_specific(3, bytes([2, 1, 3, 0, 1, 0]), extra=b"\xcc"),
    )
    data = descriptor(5, bytes([1, 9]) + le(200, 2) + bytes([1, 0, 0]), extra=b"\xdd\xee")
    play = (general_1(1), format_1(2, 2, 16, [48_000]))
    return configuration(
        interface(0, 0, (1, 1, 0), units, extra=b"\x01\x02\x03"),
        streaming(1, 0, UAC1),
        streaming(1, 1, UAC1, *play, data, stream_endpoint_1(extra=b"\x77")),
    )


SHAPES = {
    build.__name__: build()
    for build in (
        headset_adapter,
        continuous_rates,
        eight_channels,
        async_dac,
        implicit_feedback,
        composite,
        midi_between,
        midi_header_names_the_stream,
        basic_3,
        full_3,
        longer_than_the_standard,
    )
}
