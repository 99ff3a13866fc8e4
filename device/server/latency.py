"""What streams of the sound server add to the delay, beside what the delay line measures.

The delay line knows when frames come and when they are asked for. It cannot see for how long they
were on the way before, nor when they are played. Servers tell little of that: PipeWire says 0. But
it is a number of blocks, found by recording both monitors side by side (tools/latency.py): the sum
is within 1 ms of what is measured.
"""

from __future__ import annotations

from device.server.snapshot import ServerSnapshot

_BLOCKS = {"PulseAudio": (0.0, 1.0), "PipeWire": (1.0, 2.0)}
"""Kind of server to blocks in the tap and in the output.

PipeWire hands over what it mixed one cycle ago, and takes from a queue of two blocks. PulseAudio
mixes ahead, and asks once one of two blocks is left.
"""


_LATENESS_S = {"PulseAudio": 0.0125}
"""Kind of server to how late its tap's frames are to be provided for at least, in seconds."""

USUAL_LATENESS_S = 0.0085
"""The same of any other, and of none."""


def least_lateness_s(snapshot: ServerSnapshot | None) -> float:
    """Seconds by which frames of a tap are to be taken for late at least. Any thread.

    An idle machine's callbacks are some ms late now and then, which the delay is not to follow.
    And with so much in hand three or four blocks of 256 frames are mostly there to be read in one
    go, on PulseAudio as well, which hands over two blocks at a time.
    """
    return _LATENESS_S.get(snapshot.kind if snapshot else "", USUAL_LATENESS_S)


def tap_latency_s(snapshot: ServerSnapshot, block_frames: int, samplerate: int) -> float:
    """Seconds from a frame's mixing until a capture of such blocks can have it. Any thread."""
    return _BLOCKS.get(snapshot.kind, (0.0, 0.0))[0] * block_frames / samplerate


def output_latency_s(snapshot: ServerSnapshot, block_frames: int, samplerate: int) -> float:
    """Seconds from a playback's asking for a frame until it is mixed. Any thread."""
    return _BLOCKS.get(snapshot.kind, (0.0, 0.0))[1] * block_frames / samplerate
