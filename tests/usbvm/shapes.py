"""Configurations of DACs that a real kernel plays to: stereo, of either class."""

from __future__ import annotations

from collections.abc import Sequence

from tests.support import usb_builder
from tests.support.usb_builder import (
    ADAPTIVE,
    ASYNCHRONOUS,
    FEEDBACK,
    ISOCHRONOUS,
    MUTE_1,
    MUTE_2,
    SPEAKER,
    STREAMING_TERMINAL,
    UAC1,
    UAC2,
    UAC3,
    VOLUME_1,
    VOLUME_2,
    audio_endpoint_1,
    clock_source,
    endpoint,
    feature_1,
    feature_2,
    format_1,
    format_2,
    general_1,
    general_2,
    header_1,
    header_2,
    input_1,
    input_2,
    output_1,
    output_2,
    stream_endpoint_1,
    stream_endpoint_2,
    streaming,
)
from tests.support.usb_shapes import hid

STEREO = 0x3
PCM, PCM8 = 1, 2
HEADPHONE_PROFILE = 0x21
MILLISECOND_2 = 4
"""bInterval at high speed: 2^(4-1) microframes."""


def dac_1(volume: bool = True, subslot: int = 2, rates: Sequence[int] = (44_100, 48_000)) -> bytes:
    """1.0, full speed, adaptive: it takes what comes. subslot: bytes of a sample."""
    on_channel = VOLUME_1 if volume else 0
    units = header_1(
        [1],
        input_1(1, STREAMING_TERMINAL, 2, STEREO),
        feature_1(2, 1, [MUTE_1, on_channel, on_channel]),
        output_1(3, SPEAKER, 2),
    )
    play = (general_1(1, PCM8 if subslot == 1 else PCM), format_1(2, subslot, 8 * subslot, rates))
    data = audio_endpoint_1(1, ISOCHRONOUS | ADAPTIVE, 200)
    return usb_builder.configuration(
        usb_builder.control(0, UAC1, units),
        streaming(1, 0, UAC1),
        streaming(1, 1, UAC1, *play, data, stream_endpoint_1()),
    )


def dac_2() -> bytes:
    """2.0, high speed, 24 bits in 4 bytes, asynchronous: its feedback says how much it takes."""
    units = header_2(
        clock_source(4),
        input_2(1, STREAMING_TERMINAL, 4, 2, STEREO),
        feature_2(2, 1, [MUTE_2, VOLUME_2, VOLUME_2]),
        output_2(3, SPEAKER, 2, 4),
    )
    data = endpoint(1, ISOCHRONOUS | ASYNCHRONOUS, 400, MILLISECOND_2)
    feedback = endpoint(0x81, ISOCHRONOUS | FEEDBACK, 4, MILLISECOND_2)
    plays = streaming(
        1, 1, UAC2, general_2(1, 2, STEREO), format_2(4, 24), data, stream_endpoint_2(), feedback
    )
    return usb_builder.configuration(
        usb_builder.association(0, 2),
        usb_builder.control(0, UAC2, units),
        streaming(1, 0, UAC2),
        plays,
    )


def game_pad() -> bytes:
    """1.0, full speed, as a DualSense: a speaker on channels 1 and 2, coils on 3 and 4."""
    units = header_1(
        [1],
        input_1(1, STREAMING_TERMINAL, 4, 0x33),
        feature_1(2, 1, [MUTE_1 | VOLUME_1, 0, 0, 0, 0]),
        output_1(3, SPEAKER, 2),
    )
    play = (general_1(1), format_1(4, 2, 16, [48_000]))
    data = audio_endpoint_1(1, ISOCHRONOUS | ADAPTIVE, 392)
    return usb_builder.configuration(
        usb_builder.control(0, UAC1, units),
        streaming(1, 0, UAC1),
        streaming(1, 1, UAC1, *play, data, stream_endpoint_1()),
    )


def headphones_3() -> bytes:
    """3.0 with the basic profile of headphones, high speed: 16 bits, stereo, 48 kHz."""
    data = endpoint(1, ISOCHRONOUS | ADAPTIVE, 192, MILLISECOND_2)
    return usb_builder.configuration(
        usb_builder.association(0, 2, UAC3, HEADPHONE_PROFILE),
        usb_builder.control(0, UAC3),
        streaming(1, 0, UAC3),
        streaming(1, 1, UAC3, data),
    )


def two_configurations() -> bytes:
    """Volume keys alone first, then a DAC of class 1; behind the device descriptor."""
    return usb_builder.configuration(hid(0, 0x81)) + usb_builder.numbered(dac_1(), 2)
