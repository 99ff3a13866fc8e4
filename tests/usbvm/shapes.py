"""Configurations of DACs that a real kernel plays to: stereo, of either class."""

from collections.abc import Sequence

from tests.support import usb_builder as usb
from tests.support.usb_shapes import PLAIN_FUNCTION_2, PLAY_2, STEREO, hid

PCM, PCM8 = 1, 2
HEADPHONE_PROFILE = 0x21
MILLISECOND_2 = 4
"""bInterval at high speed: 2^(4-1) microframes."""


def dac_1(volume: bool = True, subslot: int = 2, rates: Sequence[int] = (44_100, 48_000)) -> bytes:
    """1.0, full speed, adaptive: it takes what comes. subslot: bytes of a sample."""
    on_channel = usb.VOLUME_1 if volume else 0
    units = usb.header_1(
        [1],
        usb.input_1(1, usb.STREAMING_TERMINAL, 2, STEREO),
        usb.feature_1(2, 1, [usb.MUTE_1, on_channel, on_channel]),
        usb.output_1(3, usb.SPEAKER, 2),
    )
    play = usb.general_1(1, PCM8 if subslot == 1 else PCM)
    play += usb.format_1(2, subslot, 8 * subslot, rates)
    stream = usb.stream(1, usb.UAC1, play, usb.audio_endpoint_1(1, usb.ADAPTIVE, 200))
    return usb.configuration(usb.control(0, usb.UAC1, units), stream)


def dac_2() -> bytes:
    """2.0, high speed, 24 bits in 4 bytes, asynchronous: its feedback says how much it takes."""
    data = usb.endpoint(1, usb.ASYNCHRONOUS, 400, MILLISECOND_2)
    feedback = usb.endpoint(0x81, usb.FEEDBACK, 4, MILLISECOND_2)
    plays = usb.streaming(1, 1, usb.UAC2, PLAY_2, data, usb.stream_endpoint_2(), feedback)
    return usb.configuration(PLAIN_FUNCTION_2, usb.streaming(1, 0, usb.UAC2), plays)


def game_pad() -> bytes:
    """1.0, full speed, as a DualSense: a speaker on channels 1 and 2, coils on 3 and 4."""
    units = usb.header_1(
        [1],
        usb.input_1(1, usb.STREAMING_TERMINAL, 4, 0x33),
        usb.feature_1(2, 1, [usb.MUTE_1 | usb.VOLUME_1, 0, 0, 0, 0]),
        usb.output_1(3, usb.SPEAKER, 2),
    )
    play = usb.general_1(1) + usb.format_1(4, 2, 16, [48_000])
    stream = usb.stream(1, usb.UAC1, play, usb.audio_endpoint_1(1, usb.ADAPTIVE, 392))
    return usb.configuration(usb.control(0, usb.UAC1, units), stream)


def headphones_3() -> bytes:
    """3.0 with the basic profile of headphones, high speed: 16 bits, stereo, 48 kHz."""
    data = usb.endpoint(1, usb.ADAPTIVE, 192, MILLISECOND_2)
    return usb.configuration(
        usb.association(0, 2, usb.UAC3, HEADPHONE_PROFILE),
        usb.control(0, usb.UAC3),
        usb.streaming(1, 0, usb.UAC3),
        usb.streaming(1, 1, usb.UAC3, data),
    )


def two_configurations() -> bytes:
    """Volume keys alone first, then a DAC of class 1; behind the device descriptor."""
    return usb.configuration(hid(0, 0x81)) + usb.numbered(dac_1(), 2)
