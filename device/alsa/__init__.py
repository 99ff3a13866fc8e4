"""Sound cards without a sound server: their formats, volumes, and the programs that use them.

| module | contents |
| --- | --- |
| `cards` | cards, their playback and capture devices, and the programs that use them |
| `offers` | the formats, rates and channel counts that a card offers, and the choice among them |
| `mixer` | a card's own volumes and mutes |
| `decibels` | the level in dB of each step of a volume control |

`device.stream` opens streams on cards.
"""

from device.alsa.cards import find_capture, find_playback, list_cards
from device.alsa.mixer import set_card_volume
from device.alsa.offers import choose_setup

__all__ = ["choose_setup", "find_capture", "find_playback", "list_cards", "set_card_volume"]
