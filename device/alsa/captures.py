"""Where the sound cards of this machine record, and what they offer there.

Nothing is ever substituted, as with what plays (cards.py): least of all a microphone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from device.alsa.cards import PROC, Card, Playback, devices_of, find_card, read, split
from device.alsa.usb_stream import UsbStream, parse_usb_stream
from device.errors import NotFoundError


@dataclass(frozen=True)
class Capture(Playback):
    """One of a card's devices that record."""

    @property
    def folder(self) -> Path:
        """What the kernel tells of this device."""
        return self.card.folder / f"pcm{self.device}c"


def captures(card: Card) -> tuple[Capture, ...]:
    """The devices of a card that record, by their number. Any thread."""
    return tuple(Capture(card, *one) for one in devices_of(card, "c"))


def find_capture(name: str, root: Path = PROC) -> Capture:
    """What `hw:` stands before, as an input: CARD or CARD,DEVICE. Any thread.

    Raises
    ------
    UsageError
        The name is written otherwise.
    NotFoundError
        There is no such card, or it does not record.
    """
    match = split(name)
    card = find_card(match["card"], root)
    found = captures(card)
    wanted = None if match["device"] is None else int(match["device"])
    for capture in found:
        if wanted in (None, capture.device):
            return capture
    there = ", ".join(f"{one} ({one.name})" for one in found) or "nothing"
    what = "anything" if wanted is None else f"a device {wanted}"
    raise NotFoundError(f"the sound card {card} has not {what} that records; there is {there}")


def usb_capture_stream(capture: Capture) -> UsbStream | None:
    """What a USB card offers to record, None if it is none. Any thread."""
    text = read(capture.card.folder / f"stream{capture.device}")
    return parse_usb_stream(text, "Capture:") if text else None
