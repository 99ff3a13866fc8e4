"""Control of PulseAudio and PipeWire. The first connection loads the library pulsectl."""

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
