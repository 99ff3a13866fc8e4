"""Where sound comes from: taps deliver buffers, clients write them into the mixer's tracks.

address         the grammar of `--tap`
tap             the interfaces of taps and clients; a part of a tap
file, film      taps on stored sound
tap_client      one tap on one track
scene           one track for each sound of a scene
applications    one track for each application
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
