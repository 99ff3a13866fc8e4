"""Benches on speed: what a second of sound costs, hot and cold, and how late the worst hop is."""

from __future__ import annotations

import time

import numpy as np

from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design.synthesis import LiveGrid
from tools.bench.cost import (
    LIMITS_RFFT_S,
    Timings,
    call_times_s,
    in_ffts,
    interleaved,
    rfft_unit_s,
)
from tools.bench.report import Missing, Must, Row, Section
from tools.bench.sounds.signals import (
    COST_SCENES,
    SAMPLERATE,
    WEAK,
    Stereo,
    demo_sound,
    white_noise,
)
from tools.bench.workbench import (
    LIVE,
    REFERENCE,
    TWIN,
    Playback,
    Stream,
    Subject,
    Workbench,
    not_compiled,
    speed_subjects,
)

BLOCKSIZES = (256, 32_768)
"""What a sound server delivers, and what a rendering takes at once."""
SECOND = Must("<=", 1.5)
SECOND_FFTS = Must("<=", in_ffts(1e-3 * SECOND.bound))
DENORMALS = (
    ("denormal numbers", "weak numbers"),
    ("denormal numbers of float64", "weak numbers of float64"),
)
SLOW_DOWN = Must("<=", 1.5)

PAUSE_S = 0.004
"""Between blocks of 256 frames at 48 kHz a thread sleeps about so long."""
COLD_SECOND = Must("<=", 10.0)
COLD_SECOND_FFTS = Must("<=", in_ffts(1e-3 * COLD_SECOND.bound))
BLOCKS_A_UNIT = 50
"""After so many blocks with pauses the unit of cost is timed anew, without a pause."""

HOP_PERCENTILE = 99.9
HOP_COST = Must("<=", 1.0)
HOPS_TO_WARM = 100


def cost_of_a_second(bench: Workbench) -> Section:
    """CPU time of a second of sound, scene by scene, in small and in large blocks."""
    effort = bench.effort
    labels: list[tuple[str, Subject, float]] = []
    playbacks: list[Playback] = []
    missing: list[Missing] = [*not_compiled("cost of a second")]
    for scene in COST_SCENES:
        sound = scene.make(effort.cost_s, bench.recordings)
        if sound is None:
            missing.append(bench.missing_recordings(f"cost of a second, {scene.name}"))
            continue
        for blocksize in BLOCKSIZES:
            for subject in speed_subjects():
                name = f"{scene.name}, blocks of {blocksize}"
                labels.append((name, subject, len(sound) / SAMPLERATE))
                playbacks.append(Playback(subject, sound, blocksize))
    rows: list[Row] = []
    all_timings = interleaved(
        [each.play for each in playbacks],
        [effort.repeats_of(subject) for _, subject, _ in labels],
        [each.open for each in playbacks],
    )
    for (name, subject, duration_s), timings in zip(labels, all_timings, strict=True):
        rows += _cost_rows(name, subject.name, timings, duration_s)
    rows += _slow_downs(rows)
    demo_s = next(duration_s for _, _, duration_s in labels)
    return Section(
        "Cost of a second of sound",
        "What a second of 48 kHz stereo costs: 10 ms are 1 % of one core. Blocks of "
        f"{BLOCKSIZES[0]} frames are what a sound server delivers, {BLOCKSIZES[1]} what a "
        f"rendering takes at once; medians over {effort.cost_s:g} s of sound (of the demo scene "
        f"{demo_s:g} s), {effort.cost_repeats} repeats of `{LIVE}` and {effort.slow_repeats} of "
        "the others, all in turns, the opening of a stream not counted. The limit in FFTs is the "
        f"one in ms on a machine whose FFT takes {1e6 * LIMITS_RFFT_S:g} µs. `{TWIN}` is the "
        "live form where its compiled kernel is not there. Denormal numbers, on which many "
        f"processors are slow, should cost what normal ones as inaudible cost ({WEAK:g}).",
        tuple(rows),
        tuple(missing),
    )


def _slow_downs(rows: list[Row]) -> list[Row]:
    """Return how many times the cost of weak normal numbers denormal ones cost."""
    costs = {(row.name, row.column): row.value for row in rows}
    ratios = []
    for blocksize in BLOCKSIZES:
        for numbers, weak in DENORMALS:
            for subject in speed_subjects():
                normal, denormal = (
                    costs[f"{scene}, blocks of {blocksize}", subject.name] or 0.0
                    for scene in (weak, numbers)
                )
                name = f"{numbers} over {weak}, blocks of {blocksize}"
                must = SLOW_DOWN if subject.name == LIVE else None
                ratios.append(Row(name, denormal / max(normal, 1e-9), "times", subject.name, must))
    return ratios


def _cost_rows(name: str, column: str, timings: Timings, duration_s: float) -> list[Row]:
    def ms(seconds: float) -> float:
        return 1e3 * seconds / duration_s

    must, must_ffts = (SECOND, SECOND_FFTS) if column == LIVE else (None, None)
    twin = f"{column}, FFTs"
    return [
        Row(
            name,
            ms(timings.median_s),
            "ms",
            column,
            must,
            low=ms(min(timings.seconds)),
            high=ms(max(timings.seconds)),
            ffts_column=twin,
        ),
        Row(name, round(timings.median_units / duration_s), "FFTs", twin, must_ffts),
    ]


def cost_after_pauses(bench: Workbench) -> Section:
    """CPU time of a second of sound where the thread sleeps between blocks, as a live one does."""
    blocksize = BLOCKSIZES[0]
    blocks = round(bench.effort.cold_s * SAMPLERATE / blocksize)
    rows: list[Row] = []
    for name, sound in (("demo scene", demo_sound()), ("white noise", white_noise(5.0))):
        cut = [
            sound[first : first + blocksize] for first in range(0, blocks * blocksize, blocksize)
        ]
        for subject in _live_subjects():
            stream = subject.start(SAMPLERATE, sound.shape[1])
            duration_s = len(cut) * blocksize / SAMPLERATE
            seconds, units = (total / duration_s for total in _cost_with_pauses(stream, cut))
            must, must_ffts = (
                (COLD_SECOND, COLD_SECOND_FFTS) if subject.name == LIVE else (None, None)
            )
            row, ffts = f"{name}, with pauses", f"{subject.name}, FFTs"
            rows.append(Row(row, 1e3 * seconds, "ms", subject.name, must, ffts_column=ffts))
            rows.append(Row(row, round(units), "FFTs", ffts, must_ffts))
    return Section(
        "Cost after pauses",
        f"Live, a thread sleeps {1e3 * PAUSE_S:g} ms between blocks of {blocksize} frames, and "
        "meanwhile other programs take the processor's caches. What a second of 48 kHz stereo "
        f"costs then, over {bench.effort.cold_s:g} s. The FFT is timed without pauses, every "
        f"{BLOCKS_A_UNIT} blocks.",
        tuple(rows),
        not_compiled("cost after pauses"),
    )


def _cost_with_pauses(stream: Stream, blocks: list[Stereo]) -> tuple[float, float]:
    """Return the thread CPU seconds of all blocks, and the same in FFTs timed between them."""
    seconds, units = 0.0, 0.0
    for first in range(0, len(blocks), BLOCKS_A_UNIT):
        unit_s = rfft_unit_s()
        some = blocks[first : first + BLOCKS_A_UNIT]
        spent_s = float(call_times_s(stream.process, some, lambda: time.sleep(PAUSE_S)).sum())
        seconds += spent_s
        units += spent_s / unit_s
    return seconds, units


def worst_hop(bench: Workbench) -> Section:
    """How far single hops stand out: the time within which 99.9 % of them are done."""
    grid = LiveGrid.at(TransformParameters(), SAMPLERATE)
    hop_s = grid.hop_frames / SAMPLERATE
    hops = bench.effort.hops_timed
    rows: list[Row] = []
    for name, sound in (("demo scene", demo_sound()), ("white noise", white_noise(15.0))):
        for subject in _live_subjects():
            count = hops if subject.name == LIVE else bench.effort.hops_timed_in_numpy
            shares = 100.0 * _hop_times_s(subject, sound, grid.hop_frames, count) / hop_s
            p999 = float(np.percentile(shares, HOP_PERCENTILE))
            must = HOP_COST if subject.name == LIVE else None
            rows += [
                Row(f"{name}, median", float(np.median(shares)), "%", subject.name),
                Row(f"{name}, p99.9", p999, "%", subject.name, must),
                Row(f"{name}, largest", float(shares.max()), "%", subject.name),
            ]
    return Section(
        "Worst hop",
        f"A hop ({grid.hop_frames} frames, {1e3 * hop_s:.1f} ms) has to be ready long before it "
        "is due, every time: CPU time of single hops as a share of the time that they last, over "
        f"{hops} hops of each sound, in NumPy {bench.effort.hops_timed_in_numpy}.",
        tuple(rows),
        not_compiled("worst hop"),
    )


def _live_subjects() -> tuple[Subject, ...]:
    """Return the live form in both ways that there are."""
    return tuple(subject for subject in speed_subjects() if subject.name != REFERENCE)


def _hop_times_s(
    subject: Subject, sound: Stereo, hop_frames: int, hops: int
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the thread CPU seconds of each hop of the looped sound, after some to warm up."""
    blocks = [
        sound[first : first + hop_frames]
        for first in range(0, len(sound) - hop_frames + 1, hop_frames)
    ]
    stream = subject.start(SAMPLERATE, sound.shape[1])
    for block in blocks[:HOPS_TO_WARM]:
        stream.process(block)
    loops = -(-hops // len(blocks))
    return call_times_s(stream.process, (blocks * loops)[:hops])
