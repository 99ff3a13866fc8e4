"""Configurations in the shapes of real devices, each without a mistake."""

from typing import Any

from device.usb.descriptors import parse_configuration, playback_formats
from tests.support import usb_builder as usb
from tests.support.usb_builder import ADAPTIVE, ASYNCHRONOUS, UAC1, UAC2, UAC3, le

STEREO = 0x3

STEREO_1 = usb.input_1(1, usb.STREAMING_TERMINAL, 2, STEREO)
SPEAKER_1 = usb.output_1(3, usb.SPEAKER, 1)
GENERAL_1, PCM_1 = usb.general_1(1), usb.format_1(2, 2, 16, [48_000])
DATA_1 = usb.audio_endpoint_1(1, ADAPTIVE, 192)


def stereo_1(
    *units: bytes, general: bytes = GENERAL_1, form: bytes = PCM_1, data: bytes = DATA_1
) -> bytes:
    """1.0 with one alternate setting that plays into these units behind a stereo terminal."""
    control = usb.control(0, UAC1, usb.header_1([1], STEREO_1, *units))
    parts = (general, form, data, usb.stream_endpoint_1())
    return usb.configuration(control, usb.streaming(1, 1, UAC1, *parts))


def hid(number: int, address: int) -> bytes:
    """The volume keys that most adapters have."""
    report = usb.descriptor(0x21, le(0x0111, 2), 0, 1, 0x22, le(60, 2))
    return usb.interface(number, 0, (usb.HID, 0, 0), report, usb.endpoint(address, 0x03, 4, 8))


def midi(number: int, address: int, packet: int) -> bytes:
    return usb.interface(
        *(number, 0, (usb.AUDIO, 3, 0)),
        usb.class_specific(1, le(0x0100, 2) + le(13, 2)),
        usb.class_specific(2, bytes([1, 1, 0])),
        usb.audio_endpoint_1(address, 2, packet, interval=0),
        usb.descriptor(0x25, bytes([1, 1, 1])),
    )


def headset_adapter() -> bytes:
    """1.0, stereo out and a microphone, also mixed into the headphones; no master volume in 9."""
    units = usb.header_1(
        [1, 2],
        usb.input_1(1, usb.STREAMING_TERMINAL, 2, STEREO),
        usb.input_1(2, usb.MICROPHONE, 1, 0),
        usb.output_1(6, usb.HEADPHONES, 9),
        usb.output_1(7, usb.STREAMING_TERMINAL, 8),
        usb.selector_1(8, [10]),
        usb.feature_1(9, 15, [usb.MUTE_1, usb.VOLUME_1, usb.VOLUME_1]),
        usb.feature_1(10, 2, [usb.MUTE_1 | usb.VOLUME_1, 0]),
        usb.feature_1(13, 2, [usb.MUTE_1 | usb.VOLUME_1, 0]),
        usb.class_specific(4, 15, usb.counted([1, 13]), 2, le(STEREO, 2), 0, 0xFF, 0),  # mixer
    )
    play = usb.general_1(1) + usb.format_1(2, 2, 16, [48_000, 44_100])
    record = usb.general_1(7) + usb.format_1(1, 2, 16, [48_000])
    return usb.configuration(
        usb.control(0, UAC1, units),
        usb.stream(1, UAC1, play, usb.audio_endpoint_1(1, ADAPTIVE, 200)),
        usb.stream(2, UAC1, record, usb.audio_endpoint_1(0x82, ASYNCHRONOUS, 100)),
        hid(3, 0x87),
    )


def adaptive_1(
    form: bytes, feature: bytes, data: bytes, terminal: bytes = STEREO_1, tag: int = 1
) -> list[bytes]:
    """1.0, adaptive, with this feature unit 2 between a terminal and a speaker: its parts."""
    units = usb.header_1([1], terminal, feature, usb.output_1(3, usb.SPEAKER, 2))
    return [usb.control(0, UAC1, units), usb.stream(1, UAC1, usb.general_1(1, tag) + form, data)]


def continuous_rates() -> bytes:
    """1.0, adaptive, any samplerate from 8 to 48 kHz; 24 bits in 3 bytes; a master volume only."""
    form = usb.format_1_range(2, 3, 24, 8_000, 48_000)
    master = usb.feature_1(2, 1, [usb.MUTE_1 | usb.VOLUME_1, 0, 0], size=2)
    parts = adaptive_1(form, master, usb.audio_endpoint_1(2, ADAPTIVE, 294))
    return usb.configuration(*parts, attributes=0xC0, units_of_2_ma=0)


def eight_channels() -> bytes:
    """1.0, 8 and 2 channels, asynchronous with feedback that only bSynchAddress names."""
    units = usb.header_1(
        [1],
        usb.input_1(1, usb.STREAMING_TERMINAL, 8, 0x063F),
        usb.processing_1(4, 1, [1], 8),
        usb.processing_1(5, 0x1234, [4], 8, subtype=8),
        usb.feature_1(2, 5, [usb.MUTE_1, *[usb.VOLUME_1] * 8]),
        usb.output_1(3, usb.SPEAKER, 2),
    )

    def parts(channels: int) -> tuple[bytes, ...]:
        play = usb.general_1(1) + usb.format_1(channels, 2, 16, [44_100, 48_000])
        data = usb.audio_endpoint_1(1, ASYNCHRONOUS, 100 * channels, synch=0x81)
        synch = usb.audio_endpoint_1(0x81, usb.ISOCHRONOUS, 3, refresh=2)
        return play, data, usb.stream_endpoint_1(), synch

    return usb.configuration(
        usb.control(0, UAC1, units),
        usb.streaming(1, 0, UAC1),
        usb.streaming(1, 1, UAC1, *parts(8)),
        usb.streaming(1, 2, UAC1, *parts(2)),
    )


def async_dac() -> bytes:
    """2.0, a clock behind a selector and a multiplier, explicit feedback; 24 in 4, 16 in 2, DSD."""
    units = usb.header_2(
        usb.clock_source(0x29, 3, 7),
        usb.clock_source(0x2A, 0, 5),
        usb.clock_selector(0x28, [0x29, 0x2A]),
        usb.class_specific(0x0C, 0x2B, 0x28, 5, 0),  # clock multiplier
        usb.input_2(2, usb.STREAMING_TERMINAL, 0x2B, 2, STEREO),
        usb.feature_2(10, 2, [usb.MUTE_2 | usb.VOLUME_2, usb.VOLUME_2, usb.VOLUME_2_READ]),
        usb.output_2(20, usb.SPEAKER, 10, 0x2B),
    )
    dfu = usb.descriptor(0x21, bytes([0x0B, 0xFA, 0, 0x40, 0, 0x10, 1]))

    def parts(subslot: int, bits: int, formats: int = 1) -> tuple[bytes, ...]:
        play = usb.general_2(2, 2, STEREO, formats) + usb.format_2(subslot, bits)
        data = usb.endpoint(1, ASYNCHRONOUS, 24 * subslot + 8)
        return play, data, usb.stream_endpoint_2(), usb.endpoint(0x81, usb.FEEDBACK, 4, 4)

    return usb.configuration(
        usb.association(0, 2),
        usb.control(0, UAC2, units),
        usb.streaming(1, 0, UAC2),
        usb.streaming(1, 1, UAC2, *parts(4, 24)),
        usb.streaming(1, 2, UAC2, *parts(2, 16)),
        usb.streaming(1, 3, UAC2, *parts(4, 32, formats=1 << 31)),
        usb.interface(2, 0, (0xFE, 1, 1), dfu),
        attributes=0xC0,
    )


def implicit_feedback() -> bytes:
    """2.0 interface with 4 channels each way: the recording endpoint tells how fast it plays."""
    units = usb.header_2(
        usb.clock_source(1, 1, 1),
        usb.input_2(2, usb.STREAMING_TERMINAL, 1, 4, 0),
        usb.output_2(3, usb.SPEAKER, 2, 1),
        usb.input_2(4, usb.MICROPHONE, 1, 4, 0),
        usb.output_2(5, usb.STREAMING_TERMINAL, 4, 1),
    )
    form, out = usb.format_2(4, 24), usb.endpoint(3, ASYNCHRONOUS, 0x0800 | 200)
    back = usb.endpoint(0x83, ASYNCHRONOUS | usb.IMPLICIT, 112)
    return usb.configuration(
        usb.association(0, 3),
        usb.control(0, UAC2, units),
        usb.stream(1, UAC2, usb.general_2(2, 4, 0), form, out),
        usb.stream(2, UAC2, usb.general_2(5, 4, 0), form, back),
    )


def composite() -> bytes:
    """HID first, then 2.0 as the function of interfaces 1 and 2, with every kind of unit."""
    units = usb.header_2(
        usb.clock_source(1, 5, 3),
        usb.clock_source(2, 1, 1),
        usb.input_2(3, usb.STREAMING_TERMINAL, 1, 2, STEREO),
        usb.input_2(4, usb.MICROPHONE, 1, 2, STEREO),
        usb.class_specific(0x0D, 5, 3, 1, 2, 0),  # sample rate converter
        usb.class_specific(7, 6, le(1, 2), 5, bytes(12), 0),  # effect unit
        usb.class_specific(8, 7, le(1, 2), usb.counted([6]), 2, bytes(8)),  # processing unit
        usb.class_specific(9, 8, le(0x55, 2), usb.counted([7]), 2, bytes(7)),  # extension unit
        usb.class_specific(4, 9, usb.counted([8, 4]), 2, le(STEREO, 4), 0, 0xF0, 0, 0),  # mixer
        usb.selector_2(11, [9, 8]),
        usb.feature_2(12, 11, [usb.MUTE_2, usb.VOLUME_2, usb.VOLUME_2]),
        usb.output_2(13, usb.HEADPHONES, 12, 2),
    )
    play = usb.general_2(3, 2, STEREO) + usb.format_2(2, 16)
    return usb.configuration(
        hid(0, 0x81),
        usb.association(1, 2),
        usb.control(1, UAC2, units),
        usb.stream(2, UAC2, play, usb.endpoint(4, usb.SYNCHRONOUS, 192)),
        usb.descriptor(0x41, b"\xca\xfe"),
    )


def midi_between() -> bytes:
    """1.0, with MIDI jacks between the control interface and the streaming one; 24 bits in 4."""
    terminals = usb.input_1(1, usb.STREAMING_TERMINAL, 2, STEREO), usb.output_1(2, usb.SPEAKER, 1)
    play = usb.general_1(1) + usb.format_1(2, 4, 24, [96_000])
    return usb.configuration(
        usb.control(0, UAC1, usb.header_1([1, 2], *terminals)),
        midi(1, 0x02, 64),
        usb.stream(2, UAC1, play, usb.audio_endpoint_1(1, ADAPTIVE, 392)),
    )


def midi_header_names_the_stream() -> bytes:
    """2.0 with implicit feedback, and MIDI whose header lists interface 1, as SSL 2+ and WING."""
    units = usb.header_2(
        usb.clock_source(0x29),
        usb.input_2(1, usb.STREAMING_TERMINAL, 0x29, 4, 0),
        usb.feature_2(5, 1, [usb.MUTE_2 | usb.VOLUME_2, 0, 0, 0, 0]),
        usb.output_2(2, usb.SPEAKER, 5, 0x29),
        usb.input_2(3, usb.MICROPHONE, 0x29, 2, 0),
        usb.output_2(4, usb.STREAMING_TERMINAL, 3, 0x29),
    )
    form, back = usb.format_2(4, 24), usb.endpoint(0x82, ASYNCHRONOUS | usb.IMPLICIT, 56)
    return usb.configuration(
        usb.association(0, 3),
        usb.control(0, UAC2, units),
        usb.stream(1, UAC2, usb.general_2(1, 4, 0), form, usb.endpoint(1, ASYNCHRONOUS, 112)),
        usb.stream(2, UAC2, usb.general_2(4, 2, 0), form, back),
        usb.control(3, UAC1, usb.header_1([1])),
        midi(4, 0x03, 512),
    )


def basic_3(profile: int = 0, interval: int = 1) -> bytes:
    """3.0 with a basic profile: no unit is described."""
    data = usb.endpoint(1, ADAPTIVE, 192, interval)
    streams = usb.streaming(1, 0, UAC3) + usb.streaming(1, 1, UAC3, data)
    return usb.configuration(usb.association(0, 2, UAC3, profile), usb.control(0, UAC3), streams)


def full_3() -> bytes:
    """3.0 with units, which are named and not understood; 24 bits in 4 bytes."""
    header = usb.class_specific(1, bytes([8]) + le(0x28, 2) + bytes(4))
    play = usb.class_specific(1, bytes([5, *bytes(4), 2, 0, 1, *bytes(7), 4, 24, 0, 0, 4]))
    return usb.configuration(
        usb.association(0, 2, UAC3),
        usb.control(0, UAC3, header, usb.class_specific(7, bytes(20))),
        usb.streaming(1, 0, UAC3),
        usb.streaming(1, 1, UAC3, play, usb.endpoint(1, ADAPTIVE, 192)),
    )


def longer_than_the_standard() -> bytes:
    """1.0 whose interface, terminal and endpoint descriptors have bytes that nobody knows."""
    units = usb.header_1(
        [1],
        usb.class_specific(2, 1, 1, 1, 0, 2, 3, 0, 0, 0, b"\xaa\xbb"),
        usb.class_specific(3, 2, 1, 3, 0, 1, 0, b"\xcc"),
    )
    data = usb.descriptor(5, 1, 9, le(200, 2), 1, 0, 0, b"\xdd\xee")
    play = usb.general_1(1) + usb.format_1(2, 2, 16, [48_000])
    return usb.configuration(
        usb.interface(0, 0, (1, 1, 0), units, extra=b"\x01\x02\x03"),
        usb.streaming(1, 0, UAC1),
        usb.streaming(1, 1, UAC1, play, data, usb.stream_endpoint_1(extra=b"\x77")),
    )


PLAIN_UNITS_2 = usb.header_2(
    usb.clock_source(4),
    usb.input_2(1, usb.STREAMING_TERMINAL, 4, 2, STEREO),
    usb.feature_2(2, 1, [usb.MUTE_2, usb.VOLUME_2, usb.VOLUME_2]),
    usb.output_2(3, usb.SPEAKER, 2, 4),
)
PLAIN_FUNCTION_2 = usb.association(0, 2) + usb.control(0, UAC2, PLAIN_UNITS_2)
PLAY_2 = usb.general_2(1, 2, STEREO) + usb.format_2(4, 24)


def plain_dac() -> bytes:
    """2.0 with one clock; mute on the master, a volume on each channel."""
    stream = usb.stream(1, UAC2, PLAY_2, usb.endpoint(1, ASYNCHRONOUS, 200))
    return usb.configuration(PLAIN_FUNCTION_2, stream)


def controls_of(configuration: bytes) -> dict[str, Any]:
    """Arguments of the `SoftwareDac` that has these controls: at -8 dB and not muted."""
    formats = playback_formats(parse_configuration(configuration))
    playback = max(formats, key=lambda one: one.volume_channels)
    return {
        "unit": playback.feature_unit,
        "endpoint": playback.endpoint_address,
        "volumes": dict.fromkeys(playback.volume_channels, -0x800),
        "mutes": dict.fromkeys(playback.mute_channels, 0),
    }


SHAPES = {
    build.__name__: build()
    for build in (
        *(headset_adapter, continuous_rates, eight_channels, async_dac, implicit_feedback),
        *(composite, midi_between, midi_header_names_the_stream, basic_3, full_3),
        longer_than_the_standard,
    )
}
