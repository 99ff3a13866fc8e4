"""The one room for the connection to the sound server; taps and outputs both go through it.

    pcms.py       names that PortAudio knows, led to sinks, monitors and cards (targets.py)
    portaudio.py  the one PyAudio instance; opening and closing within a time limit
    streams.py    CaptureStream, PlaybackStream: a block a callback
    pulse.py      PulseConnection: what the server holds (snapshot.py) and what changes (events.py)
    identity.py   sinks by exact name, monitors, our own streams, real devices
    measuring.py  two streams for one measurement, which end it on anything unexpected
    guard.py      a stream is where it belongs, or silent
    applications.py  which applications are captured by themselves, before the mix
    app_captures.py  AppCaptures opens an AppCapture (app_capture.py) for each
    pulse_thread.py  their connection and thread; libpulse.py: the library that they call
    drop_in.py    DropIn: the sound passes a virtual sink, which the server forwards
                  (forwarding.py, default_sink.py, guests.py)
    priority.py   real-time priority for the callbacks' threads
    folders.py    where the private ALSA configuration lies, and what others left behind
    quiet.py      what the libraries print; foreign_thread.py: what Python holds for callbacks

pulsectl and PyAudio are loaded when they are first needed: both need libraries of the system.
"""

from device.server.app_capture import AppCapture, Ended
from device.server.app_captures import AppCaptures
from device.server.applications import AppRules
from device.server.drop_in import DropIn
from device.server.events import Event, Listener, backoff_s
from device.server.guard import Hold, Refuge, StreamGuard
from device.server.identity import (
    default_monitor,
    find_monitor,
    find_sink,
    find_source,
    identity_of,
    is_ours,
    monitor_of,
)
from device.server.pulse import PulseConnection
from device.server.snapshot import ServerSnapshot, Sink, Source, Stream
from device.stream.pcms import Pcm, PcmConfig
from device.stream.priority import AudioPriority
from device.stream.stderr_filter import quiet_libraries
from device.stream.streams import CaptureStream, PlaybackStream

__all__ = [
    "AppCapture",
    "AppCaptures",
    "AppRules",
    "AudioPriority",
    "CaptureStream",
    "DropIn",
    "Ended",
    "Event",
    "Hold",
    "Listener",
    "Pcm",
    "PcmConfig",
    "PlaybackStream",
    "PulseConnection",
    "Refuge",
    "ServerSnapshot",
    "Sink",
    "Source",
    "Stream",
    "StreamGuard",
    "backoff_s",
    "default_monitor",
    "find_monitor",
    "find_sink",
    "find_source",
    "identity_of",
    "is_ours",
    "monitor_of",
    "quiet_libraries",
]
