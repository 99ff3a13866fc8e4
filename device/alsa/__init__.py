"""Sound cards themselves: which there are, what they offer, and what is sent to them.

    cards.py        the cards of this machine, by number or id
    captures.py     where they record
    usb_stream.py   what a USB card offers, and its own clock
    use.py          who plays there just now, and how
    mixer.py        a card's own volumes and mutes; decibels.py: what their steps mean
    volume.py       all of them, to one level
    negotiation.py  the format, rate and channels that suit best

PCMs and streams are those of `device.server`; nothing here plays.
"""

from device.alsa.captures import Capture, captures, find_capture, usb_capture_stream
from device.alsa.cards import PROC, Card, Playback, all_cards, find_card, find_playback, playbacks
from device.alsa.negotiation import Choice, Offer, choose, offers_of
from device.alsa.usb_stream import UsbFormat, UsbStream, usb_stream
from device.alsa.use import HwParams, Owner, hw_params, owner, refusal
from device.alsa.volume import set_card_volume

__all__ = [
    "PROC",
    "Capture",
    "Card",
    "Choice",
    "HwParams",
    "Offer",
    "Owner",
    "Playback",
    "UsbFormat",
    "UsbStream",
    "all_cards",
    "captures",
    "choose",
    "find_capture",
    "find_card",
    "find_playback",
    "hw_params",
    "offers_of",
    "owner",
    "playbacks",
    "refusal",
    "set_card_volume",
    "usb_capture_stream",
    "usb_stream",
]
