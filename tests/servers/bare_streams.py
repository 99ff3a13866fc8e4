"""What streams alone cost: a capture and a playback whose callbacks do nothing, until it is killed.

A program of its own, `python -m tests.servers.bare_streams TAP SINK`, so that its processor time
can be told from the daemon's.
"""

import sys
import threading

from device.server import CaptureStream, PcmConfig, PlaybackStream, quiet_libraries
from device.units import Float32Array
from tests.servers.listening import RATE_HZ


def nothing(frames: Float32Array, now_s: float) -> None:
    """A callback."""


def main(tap: str, sink: str) -> None:
    """Open both, say so, and stay."""
    quiet_libraries()
    config = PcmConfig("bare_tap", "bare_output")
    config.pcms["bare_output"].lead(sink)
    playback = PlaybackStream(config.pcms["bare_output"], RATE_HZ, 2, nothing)
    playback.audible = True
    config.pcms["bare_tap"].lead(tap)
    capture = CaptureStream(config.pcms["bare_tap"], RATE_HZ, 2, nothing)
    print("ready", flush=True)
    threading.Event().wait()
    del playback, capture


if __name__ == "__main__":
    main(*sys.argv[1:])
