"""Sound cards without a sound server: their formats, volumes, and the programs that use them.

`device.stream` opens streams on cards.
"""

from device.alsa.cards import find_capture, find_playback, list_cards
from device.alsa.mixer import set_card_volume
from device.alsa.offers import choose_setup

__all__ = ["choose_setup", "find_capture", "find_playback", "list_cards", "set_card_volume"]
