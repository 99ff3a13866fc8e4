"""Clients: who plays into the mixer's tracks, and how long each cycle is.

A tap becomes one track (`TapClient`), a scene one track a sound (`SceneClient`).
"""

from audioflinger_hook.clients.address import TapAddress, open_client, open_tap, parse_tap
from audioflinger_hook.clients.client import Client
from audioflinger_hook.clients.scene import SceneClient, mixdown
from audioflinger_hook.clients.tap import TapClient

__all__ = [
    "Client",
    "SceneClient",
    "TapAddress",
    "TapClient",
    "mixdown",
    "open_client",
    "open_tap",
    "parse_tap",
]
