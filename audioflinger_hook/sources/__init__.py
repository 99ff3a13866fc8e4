"""Sources of sound: taps deliver buffers, and clients write the buffers to tracks of the mixer.

address -> file, film -> tap_client -> one track; scene, applications -> one track for each sound
"""

from audioflinger_hook.sources.address import TapAddress, open_client, open_tap, parse_tap
from audioflinger_hook.sources.applications import VoicesClient
from audioflinger_hook.sources.file import CaptureTap, FileTap, FramesTap
from audioflinger_hook.sources.scene import SceneClient, mixdown
from audioflinger_hook.sources.tap import Client, Tap
from audioflinger_hook.sources.tap_client import PushTap, TapClient

__all__ = [
    "CaptureTap",
    "Client",
    "FileTap",
    "FramesTap",
    "PushTap",
    "SceneClient",
    "Tap",
    "TapAddress",
    "TapClient",
    "VoicesClient",
    "mixdown",
    "open_client",
    "open_tap",
    "parse_tap",
]
