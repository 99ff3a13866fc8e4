"""Bench on the rig: how its cost grows with sample rate, duration and number of actuators."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from audioflinger_hook.transform import FloatArray
from device.rig import PAPER
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.model_levels import ModelLevel
from tools.bench.cost import interleaved
from tools.bench.measures.vibration import growth_exponent
from tools.bench.report import Row, Section, number
from tools.bench.sections.scaling import LINEAR
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Workbench

RATES = (8_000, 16_000, 48_000, 96_000, 192_000)
DURATION_PARTS = (8, 4, 2, 1)
ACTUATORS = (1, 2, 4, 8)
LONGEST_S = 4.0
REPEATS = 3
TOLERANCE = 1e-2
LEVEL_V = 10.0

RUNGS = (ModelLevel.LINEAR, ModelLevel.NONLINEAR, None)
"""None: the ladder at its tolerance."""
DURATION, NUMBER = "duration: exponent", "number of actuators: exponent"


def rig_growth(bench: Workbench) -> Section:
    """What a second of signal costs at other rates, over other durations, on more actuators."""
    longest_s = min(LONGEST_S, bench.effort.rig_s / 20.0)
    sizes = [
        *((rate, longest_s, 1) for rate in RATES),
        *((SAMPLERATE, longest_s / part, 1) for part in DURATION_PARTS),
        *((SAMPLERATE, longest_s, count) for count in ACTUATORS),
    ]
    rows = []
    for rung in RUNGS:
        column = f"{rung}" if rung else f"chosen at {TOLERANCE:g}"
        timings = interleaved([_work(rung, *size) for size in sizes], REPEATS)
        costs = [timing.median_s for timing in timings]
        rows += _rows(column, longest_s, costs)
    return Section(
        "Growth of the rig's cost",
        "CPU time of the same drive, a tone that swells, as ratios within one run: at another "
        f"sample rate, to that at {number(SAMPLERATE)} Hz; over another duration, a second's share "
        "to that of the shortest; on several actuators, each one's share to that of one alone. "
        "Cost in proportion is a ratio of 1 for durations and actuators, and the exponent p of "
        "cost ~ size^p is 1.",
        tuple(rows),
        footnote="The linear part goes sample by sample, so it grows with the rate; the nodes of "
        "the non-linear one stay at about 6 kHz whatever the rate, finer ones cost only where the "
        "motion is put back between them.",
    )


def _rows(column: str, longest_s: float, costs: list[float]) -> list[Row]:
    by_rate = costs[: len(RATES)]
    by_duration = costs[len(RATES) : -len(ACTUATORS)]
    by_number = costs[-len(ACTUATORS) :]
    usual = by_rate[RATES.index(SAMPLERATE)]
    rows = [
        Row(f"sample rate: {number(rate / 1e3)} kHz", cost / usual, "times", column)
        for rate, cost in zip(RATES, by_rate, strict=True)
    ]
    rows.append(Row("sample rate: exponent", _exponent(RATES, by_rate), "", column))
    durations = [longest_s / part for part in DURATION_PARTS]
    shares = [cost / length_s for cost, length_s in zip(by_duration, durations, strict=True)]
    rows += [
        Row(f"duration: {number(length_s)} s, a second of it", share / shares[0], "times", column)
        for length_s, share in zip(durations, shares, strict=True)
    ]
    rows.append(Row(DURATION, _exponent(durations, by_duration), "", column, LINEAR))
    rows += [
        Row(f"number of actuators: {count}, each", cost / count / by_number[0], "times", column)
        for count, cost in zip(ACTUATORS, by_number, strict=True)
    ]
    rows.append(Row(NUMBER, _exponent(ACTUATORS, by_number), "", column, LINEAR))
    return rows


def _exponent(sizes: tuple[int, ...] | list[float], costs: list[float]) -> float:
    return growth_exponent([float(size) for size in sizes], costs)


def _work(
    rung: ModelLevel | None, samplerate: int, duration_s: float, actuators: int
) -> partial[None]:
    times = np.arange(round(samplerate * duration_s)) / samplerate
    swell = 0.2 + 0.8 * np.sin(math.pi * times / duration_s) ** 2
    volts = LEVEL_V * swell * np.sin(math.tau * 60.0 * times)
    ladders = [AdaptiveActuator(PAPER, samplerate, TOLERANCE, level=rung) for _ in range(actuators)]
    return partial(_move_all, ladders, volts)


def _move_all(ladders: list[AdaptiveActuator], volts: FloatArray) -> None:
    for ladder in ladders:
        ladder.reset()
        ladder.move(volts)
