"""Sound cards, their devices, and the programs that use them, read from /proc/asound.

A card is found only by its exact id or number; an error suggests similar or existing ids. A card
that is unplugged while its files are read counts as missing.
"""

import os
import re
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from device.errors import NotFoundError, UsageError
from device.values import no_such

PROC = Path("/proc/asound")
DEVICES = Path("/dev/snd")

_CARD = re.compile(r"^\s*(\d+) \[(\S+)\s*\]: (\S+) - (.*)$")
_ADDRESS = re.compile(r"(?:CARD=)?(?P<card>[^,=\s]+)(?:,(?:DEV=)?(?P<device>\d+))?")


@dataclass(frozen=True)
class Card:
    """One sound card."""

    number: int  # in ALSA; another card may get the number later
    id: str  # one word, stable unless several cards have the same id
    driver: str
    name: str
    root: Path = field(repr=False)  # the /proc/asound directory

    def __str__(self) -> str:
        return f"hw:{self.id}"

    @property
    def folder(self) -> Path:
        """Directory of the kernel's files about this card."""
        return self.root / f"card{self.number}"

    @property
    def usb_id(self) -> tuple[str, str]:
        """USB vendor id and product id, four hexadecimal digits each; "" for other cards."""
        vendor, _, product = read_text(self.folder / "usbid").strip().partition(":")
        return vendor, product


@dataclass(frozen=True)
class AlsaDevice:
    """A playback or capture device of a card. device: its number on the card, usually 0."""

    card: Card
    device: int
    name: str
    kind: str = "playback"  # or "capture"

    def __str__(self) -> str:
        return f"{self.card},{self.device}"

    @property
    def folder(self) -> Path:
        """Directory of the kernel's files about this device."""
        return self.card.folder / f"pcm{self.device}{self.kind[0]}"


@dataclass(frozen=True)
class HwParams:
    """The settings of an opened device. format: sample format, as ALSA names it. samplerate: Hz."""

    format: str
    samplerate: int
    channels: int
    period_frames: int
    buffer_frames: int

    @property
    def delay_s(self) -> float:
        """Delay in s of a frame that is written as soon as one period of the buffer is free."""
        return (self.buffer_frames - self.period_frames) / self.samplerate


def list_cards(root: Path = PROC) -> tuple[Card, ...]:
    """Return all cards, sorted by number. root: the kernel's directory of sound cards."""
    found = []
    for line in read_text(root / "cards").splitlines():
        if match := _CARD.match(line):
            number, card_id, driver, name = match.groups()
            found.append(Card(int(number), card_id, driver, name.strip(), root))
    return tuple(sorted(found, key=lambda card: card.number))


def list_devices(card: Card, kind: str = "playback") -> tuple[AlsaDevice, ...]:
    """Return a card's devices, sorted by number. kind: "playback" or "capture"."""
    found = (
        AlsaDevice(card, int(number), read_fields(folder / "info").get("name", ""), kind)
        for folder in card.folder.glob(f"pcm*{kind[0]}")
        if (number := folder.name[3:-1]).isdecimal()
    )
    return tuple(sorted(found, key=lambda device: device.device))


def find_card(name: str, root: Path = PROC) -> Card:
    """Return the card with this number or id. NotFoundError: no such card exists."""
    cards = list_cards(root)
    for card in cards:
        if name in (card.id, str(card.number)):
            return card
    # a number has no similar ids
    names = [f"{card.number} ({card.id})" if name.isdecimal() else card.id for card in cards]
    raise NotFoundError(
        no_such("sound card", name, names, "connect one, or name a sink of the sound server")
    )


def find_playback(name: str, root: Path = PROC, kind: str = "playback") -> AlsaDevice:
    """Return the device of a card at an address: CARD or CARD,DEVICE.

    name: the address. CARD is a number or an id; CARD alone means the card's first device. root:
    the kernel's directory of sound cards. kind: "playback" or "capture".
    UsageError: the address is malformed. NotFoundError: the card or device does not exist.
    """
    match = parse_card_address(name)
    card = find_card(match["card"], root)
    found = list_devices(card, kind)
    for one in found:
        if match["device"] is None or int(match["device"]) == one.device:
            return one
    if not found:
        raise NotFoundError(f"the sound card {card} has no {kind} device; name another card")
    names = ", ".join(f"{one} ({one.name})" for one in found)
    wanted = int(match["device"])
    raise NotFoundError(f"the sound card {card} has no {kind} device {wanted}; it has {names}")


find_capture = partial(find_playback, kind="capture")  # like `find_playback`, for capture devices


def parse_card_address(name: str) -> re.Match[str]:
    """Return a match with the groups `card` and `device`. UsageError: the address is malformed."""
    if (match := _ADDRESS.fullmatch(name)) is None:
        raise UsageError(
            f"device 'hw:{name}' is not hw:CARD or hw:CARD,DEVICE, with the card's number or id "
            "from /proc/asound/cards"
        )
    return match


def read_text(path: Path) -> str:
    """Return the text of a kernel file; "" if it cannot be read."""
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""


def read_fields(path: Path) -> dict[str, str]:
    """Return a kernel file's lines "name: text" as {name: text}; {} if it cannot be read."""
    lines = (line.partition(":") for line in read_text(path).splitlines())
    return {name.strip(): text.strip() for name, colon, text in lines if colon}


def read_hw_params(playback: AlsaDevice) -> tuple[HwParams, ...]:
    """Return the settings of each open substream of the device; empty if none is open."""
    opened = []
    for folder in sorted(playback.folder.glob("sub*")):
        found = read_fields(folder / "hw_params")
        with suppress(KeyError, ValueError, IndexError):
            names = ("rate", "channels", "period_size", "buffer_size")
            numbers = [int(found[name].split()[0]) for name in names]
            opened.append(HwParams(found["format"], *numbers))
    return tuple(opened)


def find_owner(playback: AlsaDevice, processes: Path = Path("/proc")) -> str | None:
    """Return the program that uses the device, such as "mpv (process 1234)".

    None: the program is unknown, or a substream is free.
    """
    first = None
    for folder in sorted(playback.folder.glob("sub*")):
        status = folder / "status"
        if read_text(status).strip() in ("closed", ""):
            return None
        digits = read_fields(status).get("owner_pid", "")
        if first is None and digits.isdecimal():
            process = read_fields(processes / digits / "status").get("Tgid", digits)
            name = read_text(processes / process / "comm").strip() or "another program"
            first = f"{name} (process {process})"
    return first


def why_blocked(
    playback: AlsaDevice, devices: Path = DEVICES, processes: Path = Path("/proc")
) -> str | None:
    """Return why this user cannot open a device, with the remedy; None if no reason is found."""
    node = devices / f"pcmC{playback.card.number}D{playback.device}{playback.kind[0]}"
    if node.exists() and not os.access(node, os.R_OK | os.W_OK):
        return (
            f"this user may not open {playback} ({node}); log in at the machine itself, or join "
            "the group audio"
        )
    if user := find_owner(playback, processes):
        return (
            f"{playback} is in use by {user}; end that program, or name the sink that the sound "
            "server has for this card (see `cushion devices`)"
        )
    return None
