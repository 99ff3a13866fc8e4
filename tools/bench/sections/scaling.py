"""Sections on scaling: growth of CPU time with duration, channels, sample rate, actuators."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from audioflinger_hook.transform import FloatArray, HapticTransform
from device.rig import PAPER
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.parameters import Model
from tools.bench.cost import interleaved
from tools.bench.report import Must, Row, Section, number
from tools.bench.sounds.signals import SAMPLERATE, Stereo, chord
from tools.bench.workbench import LIVE, Playback, Subject, Workbench, timed

CHANNELS = (1, 2, 4, 8, 16, 32)
DURATION_PARTS = (16, 8, 4, 2, 1)
LINEAR = Must("<=", 1.1)
TOTAL, PER_UNIT = "CPU time", "for each second or channel-second"
REPEATS, OPENINGS = 3, 15
BLOCKSIZE = 32_768

RIG_RATES = (48_000, 8_000, 16_000, 96_000, 192_000)
RIG_DURATION_PARTS = (8, 4, 2, 1)
ACTUATORS = (1, 2, 4, 8)
RIG_LONGEST_S = 4.0
TOLERANCE = 1e-2
LEVEL_V = 10.0
MODELS: dict[Model, str] = {
    "linear": "linear", "nonlinear": "non-linear", "auto": f"selected at {TOLERANCE:g}"
}  # fmt: skip


def exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """Fit cost ~ size^p to all points, and return p, which is 1 for linear growth."""
    slope, _ = np.polyfit(np.log(sizes), np.log(costs), 1)
    return float(slope)


def cost_scaling(bench: Workbench) -> Section:
    """Measure CPU time by duration and by number of channels."""
    effort = bench.effort
    live = bench.subject(LIVE)
    each = Subject(LIVE, partial(HapticTransform, form="live", per_channel=True))
    (opening,) = interleaved([lambda: live.start(SAMPLERATE, 2)], OPENINGS)
    durations_s = [effort.scaling_s / part for part in DURATION_PARTS]
    voice = chord(effort.channels_s)[:, :1]
    rows = [Row("opening a stream", 1e3 * opening.median_s, "ms", TOTAL)]
    rows += _rows(
        "duration",
        [(f"{duration_s:g} s of stereo", duration_s) for duration_s in durations_s],
        [(live, chord(duration_s)) for duration_s in durations_s],
        1.0,
    )
    rows += _rows(
        "separate channels",
        [(f"{count} of them, {effort.channels_s:g} s", float(count)) for count in CHANNELS],
        [(each, np.repeat(voice, count, axis=1)) for count in CHANNELS],
        effort.channels_s,
    )
    return Section(
        "Scaling of cost",
        "The cost should be proportional to the duration of the sound and to the number of "
        "channels. The exponent p of cost ~ size^p is then 1. The sound is a chord of ten "
        "partials in blocks of 32 768 frames. The time to open a stream has its own row, and is "
        "not part of the other rows.",
        tuple(rows),
    )


def _rows(
    what: str, sizes: list[tuple[str, float]], sounds: list[tuple[Subject, Stereo]], unit_s: float
) -> list[Row]:
    timings = timed([Playback(*sound, BLOCKSIZE) for sound in sounds], REPEATS)
    costs_ms = [1e3 * timing.median_s for timing in timings]
    rows = []
    for (name, size), cost_ms in zip(sizes, costs_ms, strict=True):
        rows.append(Row(f"{what}: {name}", cost_ms, "ms", TOTAL))
        rows.append(Row(f"{what}: {name}", cost_ms / (size * unit_s), "ms", PER_UNIT))
    fitted = exponent([size for _, size in sizes], costs_ms)
    return [*rows, Row(f"{what}: exponent", fitted, "", TOTAL, LINEAR)]


def rig_scaling(bench: Workbench) -> Section:
    """Measure CPU time of the rig by sample rate, duration and number of actuators."""
    longest_s = min(RIG_LONGEST_S, bench.effort.rig_s / 20.0)
    durations_s = [longest_s / part for part in RIG_DURATION_PARTS]
    # A row has label, sizes, divisors of costs, arguments of _rig_work, and the exponent's limit.
    tables = (
        ("sample rate: {} kHz", [rate / 1e3 for rate in RIG_RATES], [1.0] * len(RIG_RATES),
         [(rate, longest_s, 1) for rate in RIG_RATES], None),
        ("duration: {} s, a second of it", durations_s, durations_s,
         [(SAMPLERATE, duration_s, 1) for duration_s in durations_s], LINEAR),
        ("number of actuators: {}, each", ACTUATORS, ACTUATORS,
         [(SAMPLERATE, longest_s, count) for count in ACTUATORS], LINEAR),
    )  # fmt: skip
    rows = []
    for model, column in MODELS.items():
        cases = [case for *_, table, _ in tables for case in table]
        timings = iter(interleaved([_rig_work(model, *case) for case in cases], REPEATS))
        for label, sizes, units, table, must in tables:
            costs = [next(timings).median_s for _ in table]
            shares = [cost / unit for cost, unit in zip(costs, units, strict=True)]
            rows += [
                Row(label.format(number(float(size))), share / shares[0], "times", column)
                for size, share in zip(sizes, shares, strict=True)
            ]
            name = f"{label.partition(':')[0]}: exponent"
            rows.append(Row(name, exponent(sizes, costs), "", column, must))
    return Section(
        "Scaling of the rig's cost",
        "The table shows ratios of CPU times. The drive signal is a tone of varying level. The "
        f"cost at each sample rate is relative to the cost at {number(SAMPLERATE)} Hz. The cost of "
        "a second of a longer signal is relative to that of the shortest signal. The cost of each "
        "of several actuators is relative to that of a single actuator. If the cost is "
        "proportional to the duration and to the number of actuators, these ratios and the "
        "exponents are 1.",
        tuple(rows),
        footnote="The linear model makes a step for each sample, so its cost rises with the "
        "sample rate. The non-linear model makes at least 40 000 steps for each second of signal.",
    )


def _rig_work(model: Model, samplerate: int, duration_s: float, actuators: int) -> partial[None]:
    times = np.arange(round(samplerate * duration_s)) / samplerate
    swell = 0.2 + 0.8 * np.sin(math.pi * times / duration_s) ** 2
    volts = LEVEL_V * swell * np.sin(math.tau * 60.0 * times)
    rigs = [AdaptiveActuator(PAPER, samplerate, TOLERANCE, model=model) for _ in range(actuators)]
    return partial(_move_all, rigs, volts)


def _move_all(rigs: list[AdaptiveActuator], volts: FloatArray) -> None:
    for rig in rigs:
        rig.reset()
        rig.move(volts)
