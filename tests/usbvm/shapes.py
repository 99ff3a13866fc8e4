"""Configurations of DACs that a real kernel plays to: stereo, of either class."""

from collections.abc import Sequence

from tests.support import usb_builder as usb
from tests.support.usb_shapes import PLAIN_FUNCTION_2, PLAY_2, adaptive_1, basic_3, hid

PCM, PCM8 = 1, 2
HEADPHONE_PROFILE = 0x21
MILLISECOND_2 = 4  # bInterval at high speed: 2^(4-1) microframes


def dac_1(volume: bool = True, subslot: int = 2, rates: Sequence[int] = (44_100, 48_000)) -> bytes:
    """1.0, full speed, adaptive: it takes what comes. subslot: bytes of a sample."""
    on_channel = usb.VOLUME_1 if volume else 0
    feature = usb.feature_1(2, 1, [usb.MUTE_1, on_channel, on_channel])
    form, data = usb.format_1(2, subslot, 8 * subslot, rates), usb.audio_endpoint_1(1, 9, 200)
    return usb.configuration(*adaptive_1(form, feature, data, tag=PCM8 if subslot == 1 else PCM))


def dac_2() -> bytes:
    """2.0, high speed, 24 bits in 4 bytes, asynchronous: its feedback says how much it takes."""
    data = usb.endpoint(1, usb.ASYNCHRONOUS, 400, MILLISECOND_2)
    feedback = usb.endpoint(0x81, usb.FEEDBACK, 4, MILLISECOND_2)
    plays = usb.streaming(1, 1, usb.UAC2, PLAY_2, data, usb.stream_endpoint_2(), feedback)
    return usb.configuration(PLAIN_FUNCTION_2, usb.streaming(1, 0, usb.UAC2), plays)


def game_pad() -> bytes:
    """1.0, full speed, as a DualSense: a speaker on channels 1 and 2, coils on 3 and 4."""
    terminal = usb.input_1(1, usb.STREAMING_TERMINAL, 4, 0x33)
    feature = usb.feature_1(2, 1, [usb.MUTE_1 | usb.VOLUME_1, 0, 0, 0, 0])
    form, data = usb.format_1(4, 2, 16, [48_000]), usb.audio_endpoint_1(1, usb.ADAPTIVE, 392)
    return usb.configuration(*adaptive_1(form, feature, data, terminal))


def headphones_3() -> bytes:
    """3.0 with the basic profile of headphones, high speed: 16 bits, stereo, 48 kHz."""
    return basic_3(HEADPHONE_PROFILE, MILLISECOND_2)


def two_configurations() -> bytes:
    """Volume keys alone first, then a DAC of class 1; behind the device descriptor."""
    return usb.configuration(hid(0, 0x81)) + usb.numbered(dac_1(), 2)
