"""How a card is opened: by rate, then channels, then resolution, and never by what it has not."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.alsa import offers as alsa
from device.alsa.offers import CardSetup, Rates, UsbFormat, choose_setup, parse_usb_stream
from device.errors import NotFoundError
from device.stream.sample_format import SampleFormat
from tests.support.sound_cards import ADAPTIVE, ASYNC


def offer(formats, channels, rates, bits=0):
    names = tuple(getattr(one, "value", one) for one in formats)
    return UsbFormat(1, 1, names, channels, rates, bits)


S16, S24, S32 = SampleFormat.S16, SampleFormat.S24_3, SampleFormat.S32
USUAL = Rates((44_100, 48_000, 96_000))

some_hz = st.sampled_from([8_000, 44_100, 48_000, 88_200, 96_000, 192_000, 384_000])
listed = st.lists(some_hz, unique=True).map(lambda some: Rates(tuple(sorted(some))))
ranges = st.builds(Rates, least=st.integers(4_000, 50_000), most=st.integers(50_000, 400_000))
formats = st.lists(st.sampled_from(alsa.PREFERRED), unique=True).map(tuple)
bits = st.sampled_from([0, 16, 24, 32])
offers = st.builds(offer, formats, st.integers(1, 8), listed | ranges, bits)


@pytest.mark.parametrize(
    ("there", "mix", "chosen"),
    [
        (USUAL, 48_000, 48_000),
        (Rates((44_100, 96_000)), 48_000, 96_000),  # a multiple, though 44100 is nearer
        (Rates((44_100, 88_200)), 48_000, 88_200),  # the next one above
        (Rates((44_100,)), 48_000, 44_100),
        (Rates((44_100, 48_000)), 96_000, 48_000),  # the highest below
        (Rates((8_000, 44_100)), 8_000, 44_100),
        (Rates(least=8_000, most=96_000), 22_050, 44_100),
        (Rates(least=8_000, most=96_000), 47_952, 47_952),
        (Rates(least=50_000, most=90_000), 48_000, 50_000),
        (Rates(least=8_000, most=384_000), 384_000, 192_000),
        (Rates((8_000, 16_000, 32_000)), 48_000, 32_000),  # a headset: the highest that it has
        (Rates(least=8_000, most=32_000), 16_000, 32_000),
    ],
)
def test_the_rate_is_that_of_the_mix_or_the_next_best(there, mix, chosen):
    assert choose_setup([offer((S32,), 2, there)], mix, 1) == CardSetup(S32, chosen, 2)


@pytest.mark.parametrize(
    ("there", "chosen"),
    [
        ([offer((S16,), 2, USUAL, 16), offer((S32,), 2, USUAL, 24)], S32),
        ([offer((S32,), 2, USUAL, 16), offer((S24,), 2, USUAL, 24)], S24),
        ([offer((S24,), 2, USUAL, 24), offer((S32,), 2, USUAL, 24)], S32),
        ([offer((S32, S24, S16), 2, USUAL)], S32),
        ([offer((S32, S16), 2, USUAL, 16)], S32),
        ([offer((S16,), 2, USUAL), offer((), 2, USUAL, 32)], S16),
    ],
)
def test_the_format_is_the_one_of_the_highest_real_resolution(there, chosen):
    assert choose_setup(there, 48_000, 1).sample_format is chosen


@pytest.mark.parametrize(
    ("there", "actuators", "least", "chosen"),
    [
        ((1, 2, 8), 1, None, 2),
        ((1, 2, 8), 1, 1, 1),
        ((1, 2, 8), 3, None, 8),
        ((1,), 1, None, 1),
        ((2, 4), 2, 6, 4),
    ],
)
def test_there_are_as_many_channels_as_actuators_and_few_more(there, actuators, least, chosen):
    some = [offer((S32,), channels, USUAL) for channels in there]
    assert choose_setup(some, 48_000, actuators, least).channels == chosen


def test_the_rate_comes_before_the_resolution_and_a_format_that_is_not_there_is_left_out():
    some = [offer((S16,), 2, Rates((48_000,)), 16), offer((S32,), 2, Rates((96_000,)), 32)]
    assert choose_setup(some, 48_000, 1) == CardSetup(S16, 48_000, 2)
    assert choose_setup(alsa.ASSUMED, 48_000, 1) == CardSetup(S32, 48_000, 2)
    assert choose_setup(alsa.ASSUMED, 48_000, 1, without={S32}) == CardSetup(S16, 48_000, 2)


def test_what_usb_cards_tell_is_what_they_offer():
    assert choose_setup(parse_usb_stream(ASYNC).formats, 48_000, 2) == CardSetup(S32, 48_000, 2)
    assert choose_setup(parse_usb_stream(ADAPTIVE).formats, 48_000, 2) == CardSetup(S24, 48_000, 8)


@pytest.mark.parametrize(
    ("some", "words"),
    [
        (parse_usb_stream(ADAPTIVE).formats, "S24_3LE/S16_LE with 8 channels at 8000 to 96000"),
        ([offer(("U8",), 9, USUAL, 8)], "U8 with 9 channels at 44100, 48000, 96000"),
        ([offer((S16,), 9, Rates((384_000,)))], "S16_LE with 9 channels at 384000 Hz"),
        ([], "it offers nothing"),
    ],
)
def test_what_cannot_be_is_refused_with_what_there_is(some, words):
    with pytest.raises(NotFoundError, match="with 9 to 32 channels at 8000 to") as error:
        choose_setup(some, 48_000, 9)
    assert words in str(error.value)


@given(st.lists(offers, max_size=4), st.integers(4_000, 200_000), st.integers(1, 4))
def test_a_choice_is_always_something_that_the_card_has(some, mix, actuators):
    fit = [one for one in some if one.formats and one.channels >= actuators]
    try:
        chosen = choose_setup(some, mix, actuators)
    except NotFoundError:
        rates = [rate for one in fit for rate in one.rates.single]
        assert not any(alsa.MIN_HZ <= rate <= alsa.MAX_HZ for rate in rates)
        return
    assert alsa.MIN_HZ <= chosen.samplerate <= alsa.MAX_HZ
    like = [one for one in fit if chosen.sample_format.value in one.formats]
    assert any(chosen.channels == one.channels and chosen.samplerate in one.rates for one in like)
    has_mix = any(mix in one.rates for one in fit)
    assert not has_mix or not alsa.USUAL_MIN_HZ <= mix <= alsa.MAX_HZ or chosen.samplerate == mix
