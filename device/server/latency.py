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


def tap_latency_s(snapshot: ServerSnapshot, block_frames: int, samplerate: int) -> float:
    """Seconds from a frame's mixing until a capture of such blocks can have it. Any thread."""
    return _BLOCKS.get(snapshot.kind, (0.0, 0.0))[0] * block_frames / samplerate


def output_latency_s(snapshot: ServerSnapshot, block_frames: int, samplerate: int) -> float:
    """Seconds from a playback's asking for a frame until it is mixed. Any thread."""
    return _BLOCKS.get(snapshot.kind, (0.0, 0.0))[1] * block_frames / samplerate
