"""What a process holds more after a long stream."""

import gc
import sys
from dataclasses import dataclass

import psutil

from tools.bench.sounds.signals import Stereo
from tools.bench.workbench import Stream

WARM_LOOPS = 2


@dataclass(frozen=True)
class Held:
    """What the process holds more at the end than at the start of `frames` frames of a stream.

    resident_kb: memory that it occupies; objects: blocks that Python allocated and did not free,
    at least one for each array.
    """

    frames: int
    resident_kb: float
    objects: int


def memory_growth(stream: Stream, sound: Stereo, blocksize: int, frames: int) -> Held:
    """Return how much more is held after about `frames` frames of a looped sound.

    Whole loops of whole blocks, so that both readings come at the same place of the sound, after
    some loops to warm up.
    """
    blocks = [
        sound[first : first + blocksize]
        for first in range(0, len(sound) - blocksize + 1, blocksize)
    ]
    loop_frames = len(blocks) * blocksize
    loops = max(1, -(-frames // loop_frames))

    def play(times: int) -> None:
        for _ in range(times):
            for block in blocks:
                stream.process(block)

    play(WARM_LOOPS)
    gc.collect()
    resident, objects = resident_bytes(), sys.getallocatedblocks()
    play(loops)
    gc.collect()
    return Held(
        loops * loop_frames,
        (resident_bytes() - resident) / 1024.0,
        sys.getallocatedblocks() - objects,
    )


def resident_bytes(pid: int | None = None) -> int:
    """Return the memory that a process occupies now, by default this one."""
    return int(psutil.Process(pid).memory_info().rss)
