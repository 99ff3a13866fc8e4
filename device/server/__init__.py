"""Control of PulseAudio and PipeWire: the server's state, and changes to it.

The library pulsectl is loaded when the first connection is made.
"""

from device.server.app_captures import AppCaptures
from device.server.app_rules import AppRules
from device.server.drop_in import DropIn
from device.server.guard import FallbackSink, StreamGuard
from device.server.pulse import PulseConnection
from device.server.snapshot import ServerSnapshot

__all__ = [
    "AppCaptures",
    "AppRules",
    "DropIn",
    "FallbackSink",
    "PulseConnection",
    "ServerSnapshot",
    "StreamGuard",
]
