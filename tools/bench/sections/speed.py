"""Sections on speed: CPU time for one second of sound, with and without pauses, and for hops."""

from __future__ import annotations

import time

import numpy as np

from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design.synthesis import LiveGrid
from tools.bench.cost import LIMITS_RFFT_S, Timings, call_times_s, rfft_unit_s
from tools.bench.report import Missing, Must, Row, Section, line
from tools.bench.sounds.signals import (
    SAMPLERATE,
    TINY,
    Stereo,
    cost_scenes,
    demo_sound,
    white_noise,
)
from tools.bench.workbench import (
    LIVE,
    SUBJECTS,
    Playback,
    Stream,
    Subject,
    Workbench,
    cost_rows,
    timed,
)

BLOCKSIZES = (256, 32_768)  # frames of a sound server's block, and of a rendering's block
SECOND_MS, COLD_SECOND_MS = 1.5, 10.0
DENORMALS = (
    ("denormal floats", "tiny normal floats"),
    ("denormal floats, float64", "tiny normal floats, float64"),
)
SLOW_DOWN = Must("<=", 1.5)
PAUSE_S = 0.004  # sleep in s of a live thread between blocks of 256 frames at 48 kHz
BLOCKS_A_UNIT = 50  # blocks with pauses between two timings of the FFT
HOP_COST = Must("<=", 1.0)
HOPS_TO_WARM = 100


def cost_of_a_second(bench: Workbench) -> Section:
    """Measure the CPU time for one second of sound, by scene and block size."""
    effort = bench.effort
    cases: list[tuple[str, Subject, float]] = []
    playbacks: list[Playback] = []
    missing: list[Missing] = []
    for scene, sound in cost_scenes(effort.cost_s, bench.recordings).items():
        if sound is None:
            missing.append(bench.missing_recordings(f"cost of a second, {scene}"))
            continue
        for blocksize in BLOCKSIZES:
            for subject in SUBJECTS:
                name = f"{scene}, blocks of {blocksize}"
                cases.append((name, subject, len(sound) / SAMPLERATE))
                playbacks.append(Playback(subject, sound, blocksize))
    timings = timed(playbacks, [effort.repeats_of(subject) for _, subject, _ in cases])
    rows: list[Row] = []
    for (name, subject, duration_s), timing in zip(cases, timings, strict=True):
        limit_ms = SECOND_MS if subject.name == LIVE else None
        rows += cost_rows(name, subject.name, timing, duration_s, limit_ms)
    return Section(
        "Cost of a second of sound",
        "The table shows CPU time for each second of 48 kHz stereo sound; 10 ms are 1 % of one "
        f"core. Blocks of {BLOCKSIZES[0]} frames are usual for live sound, blocks of "
        f"{BLOCKSIZES[1]} for files. Values are medians of {effort.cost_repeats} interleaved "
        f"repeats for `{LIVE}` and of {effort.slow_repeats} for the reference form, over "
        f"{effort.cost_s:g} s of sound. The time to open a stream is not included. The limits in "
        "FFTs are the limits in ms, converted for a machine whose FFT takes "
        f"{1e6 * LIMITS_RFFT_S:g} µs. Many processors compute slowly with denormal floats. In the "
        f"transform, denormal floats should have the same cost as tiny normal floats ({TINY:g}).",
        (*rows, *_slow_downs(rows)),
        tuple(missing),
    )


def _slow_downs(rows: list[Row]) -> list[Row]:
    costs = {(row.name, row.column): row.value or 0.0 for row in rows}
    ratios: list[Row] = []
    for blocksize in BLOCKSIZES:
        end = f", blocks of {blocksize}"
        for denormal, normal in DENORMALS:
            values: dict[str, float | None] = {
                subject.name: costs[denormal + end, subject.name]
                / max(costs[normal + end, subject.name], 1e-9)
                for subject in SUBJECTS
            }
            must = SLOW_DOWN if LIVE in values else None
            ratios += line(f"{denormal} over {normal}{end}", values, "times", must)
    return ratios


def cost_after_pauses(bench: Workbench) -> Section:
    """Measure the CPU time for one second of sound if the thread sleeps between blocks."""
    blocksize = BLOCKSIZES[0]
    count = round(bench.effort.cold_s * SAMPLERATE / blocksize)
    rows: list[Row] = []
    for name, sound in (("demo scene", demo_sound()), ("white noise", white_noise(5.0))):
        blocks = np.split(sound[: count * blocksize], count)
        stream = SUBJECTS[0].start(SAMPLERATE, sound.shape[1])
        timing = _timed_with_pauses(stream, blocks)
        duration_s = count * blocksize / SAMPLERATE
        rows += cost_rows(f"{name}, with pauses", LIVE, timing, duration_s, COLD_SECOND_MS)
    return Section(
        "Cost after pauses",
        "Audio threads sleep between blocks, while other programs fill the processor's caches. "
        "The table shows the cost of a second of 48 kHz stereo sound, with pauses of "
        f"{1e3 * PAUSE_S:g} ms between blocks of {blocksize} frames. The sounds last "
        f"{bench.effort.cold_s:g} s. The FFT, the unit of cost, is timed without pauses.",
        tuple(rows),
    )


def _timed_with_pauses(stream: Stream, blocks: list[Stereo]) -> Timings:
    seconds = units = 0.0
    for first in range(0, len(blocks), BLOCKS_A_UNIT):
        unit_s = rfft_unit_s()
        some = blocks[first : first + BLOCKS_A_UNIT]
        spent_s = float(call_times_s(stream.process, some, lambda: time.sleep(PAUSE_S)).sum())
        seconds += spent_s
        units += spent_s / unit_s
    return Timings([seconds], [units])


def worst_hop(bench: Workbench) -> Section:
    """Measure the CPU time of single hops."""
    grid = LiveGrid.at(TransformParameters(), SAMPLERATE)
    hop_s = grid.hop_frames / SAMPLERATE
    effort = bench.effort
    rows: list[Row] = []
    for name, sound in (("demo scene", demo_sound()), ("white noise", white_noise(15.0))):
        times_s = _hop_times_s(SUBJECTS[0], sound, grid.hop_frames, effort.hops_timed)
        for what, share in (("median", 50.0), ("p99.9", 99.9), ("largest", 100.0)):
            must = HOP_COST if what == "p99.9" else None
            value = 100.0 / hop_s * float(np.percentile(times_s, share))
            rows += line(f"{name}, {what}", {LIVE: value}, "%", must)
    return Section(
        "Worst hop",
        f"A *hop* is the interval between two analyses of the sound ({grid.hop_frames} frames, "
        f"{1e3 * hop_s:.1f} ms). The computation of a hop must take much less time than the hop "
        "lasts. The table shows the CPU time of single hops relative to the duration of a hop, "
        f"for {effort.hops_timed} hops of each sound.",
        tuple(rows),
    )


def _hop_times_s(
    subject: Subject, sound: Stereo, hop_frames: int, hops: int
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    whole = len(sound) // hop_frames
    blocks = np.split(sound[: whole * hop_frames], whole)
    stream = subject.start(SAMPLERATE, sound.shape[1])
    for block in blocks[:HOPS_TO_WARM]:
        stream.process(block)
    return call_times_s(stream.process, (blocks * -(-hops // whole))[:hops])
