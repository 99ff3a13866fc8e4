"""Clients: who plays into the mixer's tracks, and how long each cycle is.

A tap becomes one track (`TapClient`), a scene one track a sound (`SceneClient`), applications one
track each (`VoicesClient`).
"""

from audioflinger_hook.clients.address import TapAddress, open_client, open_tap, parse_tap
from audioflinger_hook.clients.client import Client
from audioflinger_hook.clients.scene import SceneClient, mixdown
from audioflinger_hook.clients.tap import TapClient
from audioflinger_hook.clients.voices import VoicesClient

__all__ = [
    "Client",
    "SceneClient",
    "TapAddress",
    "TapClient",
    "VoicesClient",
    "mixdown",
    "open_client",
    "open_tap",
    "parse_tap",
]
