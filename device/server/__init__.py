"""Control of PulseAudio and PipeWire: the server's state, and changes to it.

| module | contents |
| --- | --- |
| `snapshot` | sinks, sources and streams at one moment; events and their listener |
| `identity` | sinks and monitors by exact name; our own streams; device identities |
| `pulse` | `PulseConnection`: snapshots, events, moves, volumes and modules |
| `defaults_check` | detects a connection to PipeWire that reports outdated defaults |
| `guard` | `StreamGuard`, `FallbackSink`: streams sound on their own device only |
| `drop_in` | `DropIn`: applications play to a virtual sink that the server forwards |
| `forwarding` | the virtual sink and its loopback, as the server reports them |
| `moved_streams` | the default sink and the streams that drop-in mode moves |
| `app_rules` | `AppRules`: which applications are captured before the mix |
| `app_captures` | `AppCaptures`: the connection that opens one capture per application |
| `app_capture` | `AppCapture`: the frames of one application |
| `connection_thread` | the thread that owns a connection and serves requests |
| `libpulse` | the functions of libpulse that record a stream |

pulsectl is loaded by the first connection.
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
