import os
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.alsa import cards as alsa
from device.alsa import offers as card_offers
from device.alsa.offers import MAX_HZ, CardSetup, Rates, UsbFormat, choose_setup, parse_usb_stream
from device.errors import NotFoundError, UsageError
from device.stream.sample_format import SampleFormat
from tests.support.sound_cards import ADAPTIVE, ASYNC, HW_PARAMS, RUNNING, Cards


@pytest.fixture
def cards(tmp_path: Path) -> Cards:
    cards = Cards(tmp_path / "asound")
    cards.plug(0, "PCH", devices=(0, 3))
    cards.plug(31, "DAC", stream=ASYNC, usb_id="1234:00aB", captures=(0,))
    return cards


def test_every_card_is_listed_with_what_it_is(cards):
    first, second = alsa.list_cards(cards.root)
    assert (first.number, first.id, first.driver) == (0, "PCH", "HDA-Intel")
    assert (second.number, second.id, second.name) == (31, "DAC", "DAC card")
    assert [str(one) for one in alsa.list_devices(first)] == ["hw:PCH,0", "hw:PCH,3"]
    assert alsa.list_devices(first)[1].name == "output 3"


def test_a_machine_without_cards_has_none(tmp_path):
    for folder in (tmp_path / "none", Cards(tmp_path / "empty").root):
        assert alsa.list_cards(folder) == ()
    with pytest.raises(NotFoundError, match="none was found; connect one"):
        alsa.find_card("0", tmp_path)


NAMES = {"0": "PCH,0", "PCH": "PCH,0", "PCH,3": "PCH,3", "CARD=PCH,DEV=3": "PCH,3"}
NAMES |= {"31,0": "DAC,0", "CARD=DAC": "DAC,0"}


@pytest.mark.parametrize(("name", "found"), NAMES.items())
def test_a_card_is_found_by_its_number_or_id(cards, name, found):
    assert str(alsa.find_playback(name, cards.root)) == f"hw:{found}"


PLAYBACK, CAPTURE = alsa.find_playback, alsa.find_capture
NO_NAME = (UsageError, "is not hw:CARD or hw:CARD,DEVICE")


@pytest.mark.parametrize(
    ("find", "name", "error", "words"),
    [
        (PLAYBACK, "DAK", NotFoundError, "no sound card 'DAK'; did you mean 'DAC'"),
        (PLAYBACK, "pch", NotFoundError, "no sound card 'pch'; there are 'DAC', 'Mic', 'PCH'"),
        (PLAYBACK, "7", NotFoundError, r"there are '0 \(PCH\)', '2 \(Mic\)', '31 \(DAC\)'"),
        (PLAYBACK, "PCH,1", NotFoundError, r"playback device 1; it has hw:PCH,0 \(output 0\), "),
        (PLAYBACK, "Mic", NotFoundError, "hw:Mic has no playback device"),
        *((PLAYBACK, name, *NO_NAME) for name in ("", "a,b", "0,1,2", "DEV=3")),
        (CAPTURE, "PCH", NotFoundError, "has no capture device; name another card"),
        (CAPTURE, "DAC,7", NotFoundError, "has no capture device 7; it has hw:DAC,0"),
        (CAPTURE, "none", NotFoundError, "no sound card 'none'"),
        (CAPTURE, "a b", *NO_NAME),
    ],
)
def test_what_is_not_there_is_an_error_that_offers_what_is(cards, find, name, error, words):
    cards.plug(2, "Mic", devices=())
    with pytest.raises(error, match=words):
        find(name, cards.root)


def test_an_input_is_found_by_its_cards_name_and_offers_its_own_formats(cards, tmp_path):
    capture = alsa.find_capture("DAC", cards.root)
    assert (str(capture), capture.folder.name) == ("hw:DAC,0", "pcm0c")
    assert alsa.why_blocked(capture, tmp_path) is None
    stream: Any = card_offers.read_usb_stream(capture)
    assert stream.formats == (UsbFormat(2, 1, ("S16_LE",), 1, Rates((8_000,)), 0, "SYNC"),)
    cards.use(31, 77, "pcm0c")
    assert "hw:DAC,0 is in use" in (alsa.why_blocked(capture, tmp_path, tmp_path) or "")
    assert alsa.why_blocked(alsa.find_playback("DAC", cards.root), tmp_path) is None


def test_a_usb_card_alone_tells_its_formats_of_playback_and_a_range_of_rates_is_one(cards):
    assert card_offers.read_usb_stream(alsa.find_playback("PCH", cards.root)) is None
    assert card_offers.read_usb_stream(alsa.find_playback("DAC", cards.root)) == parse_usb_stream(
        ASYNC
    )
    first, second, third = parse_usb_stream(ASYNC).formats
    rates = Rates((44_100, 48_000, 88_200, 96_000, 176_400, 192_000))
    assert first == UsbFormat(1, 1, ("S16_LE",), 2, rates, 16, "ASYNC")
    assert second == UsbFormat(1, 2, ("S32_LE",), 2, rates, 24, "ASYNC")
    assert third.formats == ("SPECIAL", "DSD_U32_BE")
    assert parse_usb_stream(RUNNING).formats == (first, second, third)
    (found,) = parse_usb_stream(ADAPTIVE).formats
    rates = Rates(least=8_000, most=96_000)
    assert found == UsbFormat(1, 1, ("S24_3LE", "S16_LE"), 8, rates, 0, "ADAPTIVE")
    assert (44_100 in rates, 96_001 in rates) == (True, False)


@pytest.mark.parametrize(
    ("now", "measured_hz"),
    [
        ("48002 Hz (0x6.0010)", 8_000 * (6 + 16 / 65_536)),  # frames in 125 us
        ("44102 Hz (0x2c.1a1c)", 1_000 * (44 + 0x1A1C / 65_536)),  # in 1 ms
        ("48000 Hz", None),
        ("0 Hz (0x0.0000)", None),
        ("many Hz (0x6.0010)", None),
    ],
)
def test_the_rate_of_the_device_s_own_clock_is_that_of_its_feedback(now, measured_hz):
    running = RUNNING.replace("48002 Hz (0x6.0010)", now)
    assert parse_usb_stream(running).measured_hz == measured_hz
    without = running.replace("    Feedback Format = 16.16\n", "")
    assert parse_usb_stream(without).measured_hz is None
    assert parse_usb_stream(ASYNC).measured_hz is None


def test_it_is_compared_with_the_rate_that_the_card_was_opened_with(tmp_path):
    folder = Cards(tmp_path).plug(1, "DAC", stream=RUNNING)
    playback = alsa.find_playback("1", tmp_path)
    assert card_offers.measure_rate(playback) is None
    (folder / "pcm0p/sub0/hw_params").write_text(HW_PARAMS.format("S32_LE", 2, 48_000))
    found: Any = card_offers.measure_rate(playback)
    assert (found.nominal_hz, round(found.ppm, 2)) == (48_000, 40.69)


known = st.sampled_from(RUNNING.splitlines() + ADAPTIVE.splitlines())


@given(st.lists(known | st.text("AIC:=(),- 0x19\u00b2", max_size=12)))
def test_no_text_is_too_strange_to_be_read(lines):
    for found in parse_usb_stream("\n".join(lines)).formats:
        assert found.channels > 0
        assert found.rates.single or 0 < found.rates.least <= found.rates.most


def test_a_free_card_has_no_owner_and_a_taken_one_is_refused(cards, tmp_path):
    playback = alsa.find_playback("DAC", cards.root)
    assert alsa.find_owner(playback) is None
    assert alsa.why_blocked(playback, tmp_path) is None
    cards.use(31, os.getpid())
    found = alsa.find_owner(playback)
    assert found is not None
    assert found.endswith(f" (process {os.getpid()})")
    assert not found.startswith("another program")
    assert f"hw:DAC,0 is in use by {found}" in (alsa.why_blocked(playback, tmp_path) or "")
    (cards.root / "card31/pcm0p/sub1").mkdir()
    (cards.root / "card31/pcm0p/sub1/status").write_text("closed\n")
    assert alsa.find_owner(playback) is None  # a substream is free


def test_the_owner_of_a_card_is_the_process_of_the_thread_that_opened_it(cards, tmp_path):
    for number in ("41", "40"):
        (tmp_path / number).mkdir()
        (tmp_path / number / "status").write_text("Name:\tloop\nTgid:\t40\n")
    (tmp_path / "40" / "comm").write_text("player\n")
    cards.use(31, 41)
    playback = alsa.find_playback("DAC", cards.root)
    assert alsa.find_owner(playback, tmp_path) == "player (process 40)"
    cards.use(31, 42)  # a thread that has ended since
    assert alsa.find_owner(playback, tmp_path) == "another program (process 42)"


def test_a_device_file_that_may_not_be_opened_is_told(cards, tmp_path, monkeypatch):
    (tmp_path / "pcmC31D0p").touch()
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    refused = alsa.why_blocked(alsa.find_playback("DAC", cards.root), tmp_path) or ""
    assert re.search("this user may not open hw:DAC,0.*join the group audio", refused)


def test_an_open_card_tells_how_it_was_opened(cards):
    playback = alsa.find_playback("DAC", cards.root)
    assert alsa.read_hw_params(playback) == ()
    path = cards.root / "card31/pcm0p/sub0/hw_params"
    path.write_text(HW_PARAMS.format("S32_LE", 2, 48_000))
    (found,) = alsa.read_hw_params(playback)
    assert found == alsa.HwParams("S32_LE", 48_000, 2, 256, 1024)
    assert found.delay_s == pytest.approx(0.016)
    path.write_text("format: S32_LE\nrate:\n")
    assert alsa.read_hw_params(playback) == ()


def offer(formats, channels, rates, bits=0):
    names = tuple(getattr(one, "value", one) for one in formats)
    return UsbFormat(1, 1, names, channels, rates, bits)


S16, S24, S32 = SampleFormat.S16, SampleFormat.S24_3, SampleFormat.S32
USUAL = Rates((44_100, 48_000, 96_000))

some_hz = st.sampled_from([8_000, 44_100, 48_000, 88_200, 96_000, 192_000, 384_000])
listed = st.lists(some_hz, unique=True).map(lambda some: Rates(tuple(sorted(some))))
ranges = st.builds(Rates, least=st.integers(4_000, 50_000), most=st.integers(50_000, 400_000))
formats = st.lists(st.sampled_from(card_offers.PREFERRED), unique=True).map(tuple)
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


def test_the_rate_comes_before_the_resolution_and_what_is_not_there_or_not_told_is_left_out():
    some = [offer((S16,), 2, Rates((48_000,)), 16), offer((S32,), 2, Rates((96_000,)), 32)]
    assert choose_setup(some, 48_000, 1) == CardSetup(S16, 48_000, 2)
    assert choose_setup(card_offers.ASSUMED, 48_000, 1) == CardSetup(S32, 48_000, 2)
    assert choose_setup(card_offers.ASSUMED, 48_000, 1, without={S32}) == CardSetup(S16, 48_000, 2)
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
        assert not any(card_offers.MIN_HZ <= rate <= MAX_HZ for rate in rates)
        return
    assert card_offers.MIN_HZ <= chosen.samplerate <= MAX_HZ
    like = [one for one in fit if chosen.sample_format.value in one.formats]
    assert any(chosen.channels == one.channels and chosen.samplerate in one.rates for one in like)
    has_mix = any(mix in one.rates for one in fit)
    assert not has_mix or not card_offers.USUAL_MIN_HZ <= mix <= MAX_HZ or chosen.samplerate == mix
