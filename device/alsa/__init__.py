"""Sound cards without a server: their formats, their users, and their own volumes.

| module | contents |
| --- | --- |
| `cards` | cards and their playback and capture devices, by number or id, and who uses them |
| `usb_stream` | the formats that a USB card offers, and its own clock |
| `negotiation` | the best format, rate and channel count for a card |
| `mixer` | a card's own volumes and mutes |
| `decibels` | what the steps of a volume mean in dB |

Streams on cards are opened by `device.stream`.
"""

from device.alsa.cards import find_capture, find_playback, list_cards
from device.alsa.mixer import set_card_volume
from device.alsa.negotiation import choose_setup

__all__ = ["choose_setup", "find_capture", "find_playback", "list_cards", "set_card_volume"]
