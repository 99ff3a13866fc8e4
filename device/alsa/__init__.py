"""Sound cards without a server: their formats, their users, and their own volumes.

| module | contents |
| --- | --- |
| `cards` | cards and their playback and capture devices, by number or id, and who uses them |
| `offers` | the formats, rates and channel counts that a card offers, and the best of them |
| `mixer` | a card's own volumes and mutes |
| `decibels` | what the steps of a volume mean in dB |

Streams on cards are opened by `device.stream`.
"""

from device.alsa.cards import find_capture, find_playback, list_cards
from device.alsa.mixer import set_card_volume
from device.alsa.offers import choose_setup

__all__ = ["choose_setup", "find_capture", "find_playback", "list_cards", "set_card_volume"]
