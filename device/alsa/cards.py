"""The sound cards of this machine, and where they play; read from /proc/asound.

Nothing is ever substituted: a card that does not match exactly is an error, which offers the
nearest ones. A card may vanish between two lines read: what is gone then counts as not there.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path

from device.errors import NotFoundError, UsageError
from device.suggest import no_such

PROC = Path("/proc/asound")

_CARD = re.compile(r"^\s*(\d+) \[(\S+)\s*\]: (\S+) - (.*)$")
_ADDRESS = re.compile(r"(?:CARD=)?(?P<card>[^,=\s]+)(?:,(?:DEV=)?(?P<device>\d+))?")


@dataclass(frozen=True)
class Card:
    """One sound card.

    number: ALSA's, which another card may have after the next plugging in. id: a word, which is
    that of the device as long as no other card has the same. driver, name, long_name: what it
    calls itself. root: the folder it was read from.
    """

    number: int
    id: str
    driver: str
    name: str
    long_name: str
    root: Path = field(repr=False)

    def __str__(self) -> str:
        return f"hw:{self.id}"

    @property
    def folder(self) -> Path:
        """What the kernel tells of this card."""
        return self.root / f"card{self.number}"

    @property
    def usb_id(self) -> str | None:
        """VID:PID in hexadecimal digits, None if it is no USB card."""
        return read_text(self.folder / "usbid").strip().lower() or None


@dataclass(frozen=True)
class PlaybackDevice:
    """One of a card's devices that play. device: its number, mostly 0."""

    card: Card
    device: int
    name: str

    def __str__(self) -> str:
        return f"{self.card},{self.device}"

    @property
    def folder(self) -> Path:
        """What the kernel tells of this device."""
        return self.card.folder / f"pcm{self.device}p"


def list_cards(root: Path = PROC) -> tuple[Card, ...]:
    """Every card by its number; none where there is no such folder. Any thread."""
    found = []
    lines = read_text(root / "cards").splitlines()
    for line, after in zip_longest(lines, lines[1:], fillvalue=""):
        if match := _CARD.match(line):
            number, card_id, driver, name = match.groups()
            found.append(Card(int(number), card_id, driver, name.strip(), after.strip(), root))
    return tuple(sorted(found, key=lambda card: card.number))


def list_playbacks(card: Card) -> tuple[PlaybackDevice, ...]:
    """The devices of a card that play, by their number. Any thread."""
    return tuple(PlaybackDevice(card, *one) for one in devices_of(card, "p"))


def devices_of(card: Card, way: str) -> list[tuple[int, str]]:
    """(number, name) of a card's devices, in order; way: "p" of those that play, "c" record."""
    return sorted(
        (int(folder.name[3:-1]), read_fields(folder / "info").get("name", ""))
        for folder in card.folder.glob(f"pcm*{way}")
        if folder.name[3:-1].isdecimal()
    )


def find_card(name: str, root: Path = PROC) -> Card:
    """The card with exactly this number or id. Any thread.

    Raises
    ------
    NotFoundError
        There is none; the nearest ids are offered.
    """
    cards = list_cards(root)
    for card in cards:
        if name in (card.id, str(card.number)):
            return card
    names = [card.id for card in cards]
    if name.isdecimal():  # no id is near to a number
        names = [f"{card.number} ({card.id})" for card in cards]
    raise NotFoundError(
        no_such("sound card", name, names, "connect one, or name a sink of the sound server")
    )


def find_playback(name: str, root: Path = PROC) -> PlaybackDevice:
    """What `hw:` stands before: CARD or CARD,DEVICE, as ALSA writes them too. Any thread.

    CARD is a number or an id; without DEVICE it is the card's first one that plays.

    Raises
    ------
    UsageError
        The name is written otherwise.
    NotFoundError
        There is no such card, or it does not play.
    """
    match = parse_card_address(name)
    card = find_card(match["card"], root)
    found = list_playbacks(card)
    if not found:
        raise NotFoundError(f"the sound card {card} has nothing that plays; name another one")
    if match["device"] is None:
        return found[0]
    for playback in found:
        if playback.device == int(match["device"]):
            return playback
    there = ", ".join(f"{one} ({one.name})" for one in found)
    raise NotFoundError(
        f"the sound card {card} has no device {match['device']} that plays; there is {there}"
    )


def parse_card_address(name: str) -> re.Match[str]:
    """The groups `card` and `device`, None if it is left out, of what `hw:` stands before.

    Any thread. UsageError: it is written otherwise; nothing is looked up.
    """
    match = _ADDRESS.fullmatch(name)
    if match is None:
        raise UsageError(
            f"device 'hw:{name}': a card is written hw:CARD or hw:CARD,DEVICE, with its number or "
            "id as in /proc/asound/cards"
        )
    return match


def read_text(path: Path) -> str:
    """The text of a file of the kernel's, empty if it is not there. Any thread."""
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""


def read_fields(path: Path) -> dict[str, str]:
    """The lines "name: text" of a file, by name; empty if it is not there. Any thread."""
    lines = (line.partition(":") for line in read_text(path).splitlines())
    return {name.strip(): text.strip() for name, colon, text in lines if colon}


@dataclass(frozen=True)
class CaptureDevice(PlaybackDevice):
    """One of a card's devices that record."""

    @property
    def folder(self) -> Path:
        """What the kernel tells of this device."""
        return self.card.folder / f"pcm{self.device}c"


def list_captures(card: Card) -> tuple[CaptureDevice, ...]:
    """The devices of a card that record, by their number. Any thread."""
    return tuple(CaptureDevice(card, *one) for one in devices_of(card, "c"))


def find_capture(name: str, root: Path = PROC) -> CaptureDevice:
    """What `hw:` stands before, as an input: CARD or CARD,DEVICE. Any thread.

    Raises
    ------
    UsageError
        The name is written otherwise.
    NotFoundError
        There is no such card, or it does not record.
    """
    match = parse_card_address(name)
    card = find_card(match["card"], root)
    found = list_captures(card)
    wanted = None if match["device"] is None else int(match["device"])
    for capture in found:
        if wanted in (None, capture.device):
            return capture
    there = ", ".join(f"{one} ({one.name})" for one in found) or "nothing"
    what = "anything" if wanted is None else f"a device {wanted}"
    raise NotFoundError(f"the sound card {card} has not {what} that records; there is {there}")
