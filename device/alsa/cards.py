"""Sound cards and their devices, read from /proc/asound.

Names must match exactly; an error suggests the nearest ones. A card may vanish between two lines
that are read: it then counts as missing.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, TypeVar

from device.errors import NotFoundError, UsageError
from device.values import no_such

PROC = Path("/proc/asound")

Device = TypeVar("Device", bound="PlaybackDevice")

_CARD = re.compile(r"^\s*(\d+) \[(\S+)\s*\]: (\S+) - (.*)$")
_ADDRESS = re.compile(r"(?:CARD=)?(?P<card>[^,=\s]+)(?:,(?:DEV=)?(?P<device>\d+))?")


@dataclass(frozen=True)
class Card:
    """One sound card.

    number: ALSA's, which another card may get later. id: one word, stable unless several cards
    have the same. driver, name: as the card reports them. root: the directory read.
    """

    number: int
    id: str
    driver: str
    name: str
    root: Path = field(repr=False)

    def __str__(self) -> str:
        return f"hw:{self.id}"

    @property
    def folder(self) -> Path:
        """Directory of the kernel's files about this card."""
        return self.root / f"card{self.number}"

    @property
    def usb_id(self) -> tuple[str, str]:
        """Vendor and product of a USB card, four hexadecimal digits each; else "" and ""."""
        vendor, _, product = read_text(self.folder / "usbid").strip().partition(":")
        return vendor, product


@dataclass(frozen=True)
class PlaybackDevice:
    """One of a card's playback devices. device: its number, usually 0."""

    card: Card
    device: int
    name: str

    kind: ClassVar[str] = "playback"

    def __str__(self) -> str:
        return f"{self.card},{self.device}"

    @property
    def folder(self) -> Path:
        """Directory of the kernel's files about this device."""
        return self.card.folder / f"pcm{self.device}{self.kind[0]}"


@dataclass(frozen=True)
class CaptureDevice(PlaybackDevice):
    """One of a card's capture devices."""

    kind: ClassVar[str] = "capture"


def list_cards(root: Path = PROC) -> tuple[Card, ...]:
    """Return all cards, sorted by number. root: of the kernel's files; none if it is missing."""
    found = []
    for line in read_text(root / "cards").splitlines():
        if match := _CARD.match(line):
            number, card_id, driver, name = match.groups()
            found.append(Card(int(number), card_id, driver, name.strip(), root))
    return tuple(sorted(found, key=lambda card: card.number))


def list_playbacks(card: Card) -> tuple[PlaybackDevice, ...]:
    """Return a card's playback devices, sorted by number."""
    return _list_devices(card, PlaybackDevice)


def _list_devices(card: Card, kind: type[Device]) -> tuple[Device, ...]:
    found = (
        kind(card, int(folder.name[3:-1]), read_fields(folder / "info").get("name", ""))
        for folder in card.folder.glob(f"pcm*{kind.kind[0]}")
        if folder.name[3:-1].isdecimal()
    )
    return tuple(sorted(found, key=lambda device: device.device))


def find_card(name: str, root: Path = PROC) -> Card:
    """Return the card with exactly this number or id.

    NotFoundError: there is none; the nearest ids are suggested.
    """
    cards = list_cards(root)
    for card in cards:
        if name in (card.id, str(card.number)):
            return card
    names = [card.id for card in cards]
    if name.isdecimal():  # ids do not resemble numbers
        names = [f"{card.number} ({card.id})" for card in cards]
    raise NotFoundError(
        no_such("sound card", name, names, "connect one, or name a sink of the sound server")
    )


def find_playback(name: str, root: Path = PROC) -> PlaybackDevice:
    """Return the playback device of an address: CARD or CARD,DEVICE.

    name: CARD is a number or an id; without DEVICE it means the card's first playback device.
    root: of the kernel's files. UsageError: the address is malformed. NotFoundError: there is no
    such card, or it has no such device.
    """
    return _find_device(name, root, PlaybackDevice)


def find_capture(name: str, root: Path = PROC) -> CaptureDevice:
    """Return the capture device of an address; name, root and errors as for `find_playback`.

    name: an address. root: of the kernel's files.
    """
    return _find_device(name, root, CaptureDevice)


def _find_device(name: str, root: Path, kind: type[Device]) -> Device:
    match = parse_card_address(name)
    card = find_card(match["card"], root)
    found = _list_devices(card, kind)
    wanted = None if match["device"] is None else int(match["device"])
    for one in found:
        if wanted in (None, one.device):
            return one
    if not found:
        raise NotFoundError(f"the sound card {card} has no {kind.kind} device; name another card")
    names = ", ".join(f"{one} ({one.name})" for one in found)
    raise NotFoundError(f"the sound card {card} has no {kind.kind} device {wanted}; it has {names}")


def parse_card_address(name: str) -> re.Match[str]:
    """Return a match with the groups `card` and `device` (None if omitted); looks nothing up.

    UsageError: the address is malformed.
    """
    match = _ADDRESS.fullmatch(name)
    if match is None:
        raise UsageError(
            f"device 'hw:{name}' is not hw:CARD or hw:CARD,DEVICE, with the card's number or id "
            "from /proc/asound/cards"
        )
    return match


def read_text(path: Path) -> str:
    """Return the text of a kernel file; "" if it is missing."""
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""


def read_fields(path: Path) -> dict[str, str]:
    """Return the lines "name: text" of a kernel file by name; empty if it is missing."""
    lines = (line.partition(":") for line in read_text(path).splitlines())
    return {name.strip(): text.strip() for name, colon, text in lines if colon}
