"""Control of PulseAudio and PipeWire: the server's state, and changes to it.

| module | contents |
| --- | --- |
| `snapshot` | sinks, sources and streams at one moment; events and their listener |
| `identity` | sinks and monitors by exact name; our own streams; device identities |
| `pulse` | `PulseConnection`: snapshots, events, moves, volumes and modules |
| `defaults_check` | detects a connection to PipeWire that reports outdated default devices |
| `guard` | `StreamGuard`, `FallbackSink`: silence a stream that is moved to another device |
| `drop_in` | `DropIn`: applications play to a virtual sink, which is forwarded to a real sink |
| `forwarding` | the virtual sink and its loopback, as the server reports them |
| `moved_streams` | the default sink and the streams that drop-in mode moves |
| `app_rules` | `AppRules`: which applications are captured before the server mixes them |
| `left_out` | `LeftOut`: calls, alerts and other streams that cause no vibration |
| `app_captures` | `AppCaptures`: the connection that opens one capture for each application |
| `app_capture` | `AppCapture`: delivers the frames of one application |
| `connection_thread` | the thread that owns a connection and serves requests |
| `libpulse` | the functions of libpulse that record a stream |
| `tap_volume` | the volume that the server has applied to the captured sound |
| `graph` | `Graph`: nodes, ports and links of PipeWire |
| `graph_watch` | `GraphWatch`: follows the graph and changes links, by pw-dump and pw-cli |
| `link_keeper` | `LinkKeeper`: requests missing links and removes unwanted links |
| `node_errors` | `NodeErrors`: counts of cycles in which PipeWire nodes were late, from pw-top |

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
