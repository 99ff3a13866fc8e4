"""Benches on growth: of cost with duration and channels, and of memory with time."""

from __future__ import annotations

import gc
import os
import resource
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from audioflinger_hook.transform import HapticTransform, TransformParameters
from audioflinger_hook.transform.design.synthesis import LiveGrid
from tools.bench.cost import Timings, interleaved
from tools.bench.measures.vibration import growth_exponent
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import (
    SAMPLERATE,
    Stereo,
    chord,
    demo_sound,
)
from tools.bench.workbench import LIVE, Playback, Stream, Subject, Workbench

CHANNELS = (1, 2, 4, 8, 16, 32)
DURATION_PARTS = (16, 8, 4, 2, 1)
LINEAR = Must("<=", 1.1)
TOTAL, PER_UNIT = "CPU time", "for each second or channel-second"
REPEATS = 3
OPENINGS = 15
BLOCKSIZE = 32_768

NO_GROWTH_KB = Must("<=", 256.0)
NO_GROWTH_OBJECTS = Must("<=", 200)
"""What the interpreter moves about by itself; a hop that kept one array would keep thousands."""
WARM_LOOPS = 2


def cost_growth(bench: Workbench) -> Section:
    """How cost grows with the sound's length and with its channels."""
    effort = bench.effort
    live = bench.subject(LIVE)
    each = Subject(LIVE, partial(HapticTransform, form="live", per_channel=True))
    (opening,) = interleaved([lambda: live.start(SAMPLERATE, 2)], OPENINGS)
    durations_s = [effort.growth_s / part for part in DURATION_PARTS]
    by_duration = _timed([(live, chord(length_s)) for length_s in durations_s])
    voice = chord(effort.channels_s)[:, :1]
    by_channels = _timed([(each, np.repeat(voice, channels, axis=1)) for channels in CHANNELS])
    rows = [Row("opening a stream", 1e3 * opening.median_s, "ms", TOTAL)]
    rows += _growth_rows(
        "duration",
        [(f"{duration_s:g} s of stereo", duration_s) for duration_s in durations_s],
        [timing.median_s for timing in by_duration],
        1.0,
    )
    rows += _growth_rows(
        "channels, each by itself",
        [
            (f"{channels} of them, {effort.channels_s:g} s", float(channels))
            for channels in CHANNELS
        ],
        [timing.median_s for timing in by_channels],
        effort.channels_s,
    )
    return Section(
        "Growth of cost",
        "Twice the sound should cost twice as much, and so should twice the channels: the "
        "exponent p of cost ~ size^p is 1. A chord of ten partials, large blocks; the opening of "
        "the stream is measured by itself and not a part of it.",
        tuple(rows),
    )


def _timed(sounds: list[tuple[Subject, Stereo]]) -> list[Timings]:
    """Return what it costs to play each sound by a subject, in turns."""
    playbacks = [Playback(subject, sound, BLOCKSIZE) for subject, sound in sounds]
    return interleaved(
        [each.play for each in playbacks], REPEATS, [each.open for each in playbacks]
    )


def _growth_rows(
    what: str, sizes: list[tuple[str, float]], costs_s: list[float], seconds: float
) -> list[Row]:
    """Return cost and cost per unit of each size, and the exponent of all."""
    rows = []
    for (name, size), cost_s in zip(sizes, costs_s, strict=True):
        rows.append(Row(f"{what}: {name}", 1e3 * cost_s, "ms", TOTAL))
        rows.append(Row(f"{what}: {name}", 1e3 * cost_s / (size * seconds), "ms", PER_UNIT))
    exponent = growth_exponent([size for _, size in sizes], costs_s)
    rows.append(Row(f"{what}: exponent", exponent, "", TOTAL, LINEAR))
    return rows


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


def memory_held(bench: Workbench) -> Section:
    """Whether a stream holds more memory the longer it runs."""
    hop_frames = LiveGrid.at(TransformParameters(), SAMPLERATE).hop_frames
    held = memory_growth(
        bench.subject(LIVE).start(SAMPLERATE, 2),
        demo_sound(),
        hop_frames,
        bench.effort.hops_held * hop_frames,
    )
    return Section(
        "Memory over time",
        "A stream may run for weeks, so it must not hold more and more: what the process holds "
        f"after {held.frames // hop_frames} hops of the demo scene in a loop, less what it held "
        "before. The soak at the end of this page is the long form of it.",
        (
            Row("growth of memory", held.resident_kb, "kB", must=NO_GROWTH_KB),
            Row("objects left over", float(held.objects), must=NO_GROWTH_OBJECTS),
        ),
    )


def resident_bytes() -> int:
    """Return the memory that the process occupies now, or did at most where Linux does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return pages * os.sysconf("SC_PAGE_SIZE")
