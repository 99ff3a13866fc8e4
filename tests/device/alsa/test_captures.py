"""Where cards record, and what they offer there: never another card's microphone."""

from __future__ import annotations

from pathlib import Path

import pytest

from device.alsa import choose_setup, find_capture
from device.alsa.negotiation import list_offers
from device.alsa.usb_stream import read_usb_stream
from device.alsa.use import why_blocked
from device.errors import NotFoundError, UsageError
from tests.support.sound_cards import Cards

STREAM = """\
Maker Interface at usb-0000:00:14.0-2, high speed : USB Audio

Playback:
  Status: Stop
  Interface 1
    Altset 1
    Format: S16_LE
    Channels: 2
    Endpoint: 0x05 (5 OUT) (ASYNC)
    Rates: 44100, 48000

Capture:
  Status: Stop
  Interface 2
    Altset 1
    Format: S32_LE
    Channels: 4
    Endpoint: 0x83 (3 IN) (ASYNC)
    Rates: 44100, 48000, 96000
"""


@pytest.fixture
def cards(tmp_path: Path) -> Cards:
    cards = Cards(tmp_path / "asound")
    cards.plug(0, "PCH")
    folder = cards.plug(1, "Interface", stream=STREAM)
    (folder / "pcm0c" / "sub0").mkdir(parents=True)
    (folder / "pcm0c" / "info").write_text("name: inputs\n")
    (folder / "pcm0c" / "sub0" / "status").write_text("closed\n")
    return cards


def test_an_input_is_found_by_its_cards_name_and_opened_as_it_offers(cards: Cards) -> None:
    capture = find_capture("Interface", cards.root)
    assert str(capture) == "hw:Interface,0"
    assert capture.folder.name == "pcm0c"
    assert why_blocked(capture) is None
    stream = read_usb_stream(capture)
    assert stream is not None
    choice = choose_setup(list_offers(stream), 48_000, 3, 3)
    assert (choice.channels, choice.samplerate) == (4, 48_000)


def test_who_records_there_is_told(cards: Cards, tmp_path: Path) -> None:
    status = cards.root / "card1" / "pcm0c" / "sub0" / "status"
    status.write_text("state: RUNNING\nowner_pid   : 77\n")
    told = why_blocked(find_capture("1", cards.root), tmp_path, tmp_path)
    assert told is not None
    assert "hw:Interface,0 is in use" in told


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("PCH", NotFoundError, "has no capture device; name another card"),
        ("Interface,7", NotFoundError, "has no capture device 7; it has hw:Interface,0"),
        ("none", NotFoundError, "no sound card 'none'"),
        ("a b", UsageError, "hw:CARD"),
    ],
)
def test_nothing_is_taken_instead_of_an_input(
    cards: Cards, name: str, error: type[Exception], words: str
) -> None:
    with pytest.raises(error) as caught:
        find_capture(name, cards.root)
    assert words in str(caught.value)
