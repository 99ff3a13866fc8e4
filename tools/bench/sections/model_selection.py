"""Sections on model selection: which model each block took, what it cost, and the true error."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.signal import butter, sosfilt

from audioflinger_hook.transform import FloatArray
from device.rig import PAPER
from device.rig.actuator import Motion
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.electronics import Amplifier, Dac
from device.rig.model_levels import ModelLevel
from device.rig.model_selection import FLOOR
from tools.bench.cost import Timings, interleaved
from tools.bench.measures.model_report import block_errors, report_seconds
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import SAMPLERATE, looped, speech
from tools.bench.workbench import LIVE, Workbench

TOLERANCES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3)
MODELS = (ModelLevel.LINEAR, ModelLevel.CORRECTED, ModelLevel.NONLINEAR)
NO_BLOCK = Must("<=", 0.0)
NO_CLICK = Must("<=", -80.0)
BURST_S = 0.25
FULL_V = 40.0
"""Loudest burst of one tone: at some frequencies the actuator reaches its stops."""
FADED_ABOVE_HZ = 800.0
REPEATS = 3
TRUE_NODES_HZ = 24_000.0

TOLERANCE = 1e-2
PART_S = 2.0
LEVELS = {"quiet": 0.02, "loud": 1.0, "quiet again": 0.02}
"""Peak of the vibration in each part, of full scale."""
CHANGE_S = 0.2
GAIN = 10.0
"""Of the amplifier, turned up by 12 dB: to a third of Xmax."""


def model_selection(bench: Workbench) -> Section:
    """Models used, cost and true error at several tolerances, and clicks at switches."""
    duration_s = bench.effort.rig_s
    volts = bursts(duration_s)
    true = AdaptiveActuator(
        PAPER, SAMPLERATE, level=ModelLevel.NONLINEAR, nodes_hz=TRUE_NODES_HZ
    ).move(volts)
    ladders = [AdaptiveActuator(PAPER, SAMPLERATE, tolerance) for tolerance in TOLERANCES]
    patient = [
        AdaptiveActuator(PAPER, SAMPLERATE, tolerance, early=False) for tolerance in TOLERANCES
    ]
    whole = AdaptiveActuator(PAPER, SAMPLERATE, level=ModelLevel.NONLINEAR)
    timed_s = min(duration_s, bench.effort.rig_timed_s)
    timed = volts[: round(timed_s * SAMPLERATE)]
    works = [partial(_afresh, ladder, timed) for ladder in (*ladders, *patient, whole)]
    *timings, whole_timing = interleaved(works, REPEATS)
    rows = []
    pairs = zip(timings[: len(ladders)], timings[len(ladders) :], strict=True)
    for ladder, (timing, patient_timing) in zip(ladders, pairs, strict=True):
        shares = shares_of_tolerance(ladder, volts, true)
        beyond = float(np.count_nonzero(shares > 1.0))
        frames = sum(ladder.frames_by_level.values())
        column = f"{ladder.tolerance:g}"
        rows += [
            Row("blocks beyond the tolerance", beyond, f"of {shares.size}", column, NO_BLOCK),
            Row("worst block, of the tolerance", float(shares.max()), "", column),
        ]
        for model in MODELS:
            share = 100.0 * ladder.frames_by_level[model] / frames
            rows.append(Row(f"{model}, share of the time", share, "%", column))
        every = _times(patient_timing, whole_timing)
        rows += [
            Row("a second of signal", 1e3 * timing.median_s / timed_s, "ms", column),
            Row("cost, of all non-linear", _times(timing, whole_timing), "times", column),
            Row("the same with an estimate of every block", every, "times", column),
            Row("clicks above 800 Hz", _clicks_db(ladder.tolerance), "dB", column, NO_CLICK),
        ]
    all_ms = 1e3 * whole_timing.median_s / timed_s
    rows.append(Row("a second of signal", all_ms, "ms", "all non-linear"))
    return Section(
        "Model selection",
        "Bursts of one tone of 20 to 220 Hz, from faint to beyond Xmax, with pauses in which the "
        "motion rings on. The rig selects a model for each block, at the tolerance over each "
        "column. A block's error is the larger one of excursion and acceleration: the largest "
        "difference from the non-linear model at four times its rate, over the block's peak or "
        f"{FLOOR:g} of Xmax. Errors over {duration_s:g} s, costs over the first {timed_s:g} s, "
        f"medians of {REPEATS} repeats.",
        tuple(rows),
    )


def _reference_model() -> AdaptiveActuator:
    """Return the non-linear model at four times its rate."""
    return AdaptiveActuator(PAPER, SAMPLERATE, level=ModelLevel.NONLINEAR, nodes_hz=TRUE_NODES_HZ)


def bursts(duration_s: float) -> FloatArray:
    """Return the volts, (frames,): bursts, each with its own tone and level, some silent."""
    random = np.random.default_rng(11)
    length = round(BURST_S * SAMPLERATE)
    times = np.arange(length) / SAMPLERATE
    edge = np.minimum(1.0, np.minimum(times, times[::-1]) / 0.005)
    parts = []
    for _ in range(math.ceil(duration_s / BURST_S)):
        level_v = FULL_V * 10.0 ** random.uniform(-3.0, 0.0) * (random.random() > 0.25)
        frequency_hz = 20.0 * 11.0 ** random.random()
        parts.append(level_v * edge * np.sin(math.tau * frequency_hz * times))
    return np.concatenate(parts)[: round(duration_s * SAMPLERATE)]


def _times(one: Timings, other: Timings) -> float:
    """Return the median of the ratios within each round."""
    return float(np.median(np.array(one.seconds) / np.array(other.seconds)))


def _afresh(ladder: AdaptiveActuator, volts: FloatArray) -> None:
    ladder.reset()
    ladder.move(volts)


def shares_of_tolerance(ladder: AdaptiveActuator, volts: FloatArray, true: Motion) -> FloatArray:
    """Return each block's true error as a share of the tolerance, (blocks,), from rest."""
    ladder.reset()
    motion = ladder.move(volts)
    errors = block_errors(ladder.reports, 0, motion, true, ladder.rig.actuator)
    return errors / ladder.tolerance


def _clicks_db(tolerance: float) -> float:
    """Return what switching leaves above 800 Hz of two tones that have nothing there."""
    times = np.arange(round(1.6 * SAMPLERATE)) / SAMPLERATE
    envelope = 0.4 + 3.0 * np.sin(math.pi * times / 1.6) ** 2
    volts = envelope * (np.sin(math.tau * 46.6 * times) + np.sin(math.tau * 92.0 * times))
    motion = AdaptiveActuator(PAPER, SAMPLERATE, tolerance).move(volts).acceleration_m_s2
    high = butter(8, FADED_ABOVE_HZ, "high", fs=SAMPLERATE, output="sos")
    left = sosfilt(high, motion)[2_000:-2_000]
    return 20.0 * math.log10(float(np.abs(left).max() / np.abs(motion).max()))


def selection_by_second(bench: Workbench) -> Section:
    """The rig's own report of one run over speech that is quiet, loud and quiet."""
    parts = tuple(LEVELS)
    title = "Model selection, second by second"
    explanation = (
        f"Recorded speech through transform, DAC and amplifier of the `{PAPER.name}` rig at a gain "
        f"of {GAIN:g}, {PART_S:g} s each {', '.join(parts)}, at a tolerance of {TOLERANCE:g}. "
        "Shares of the time by model, the largest predicted error of a block of that second, and "
        "the true error against the non-linear model at four times its rate."
    )
    sound = speech(bench.recordings)
    if sound is None:
        missing = bench.missing_recordings("a run second by second")
        return Section(title, explanation, (), (missing,))
    vibration = bench.subject(LIVE).vibration(looped(sound, PART_S * len(parts)), SAMPLERATE)
    rows = []
    for told in report_seconds(
        AdaptiveActuator(PAPER, SAMPLERATE, TOLERANCE),
        _volts(vibration),
        clock=time.thread_time,
        reference=AdaptiveActuator(
            PAPER, SAMPLERATE, level=ModelLevel.NONLINEAR, nodes_hz=TRUE_NODES_HZ
        ),
    ):
        name = f"{told.second} to {told.second + 1} s, {parts[int(told.second // PART_S)]}"
        rows += [Row(name, 100.0 * told.shares[model], "%", f"{model}") for model in MODELS]
        reached = 100.0 * told.excursion_peak_m / PAPER.actuator.x_max_m
        rows.append(Row(name, reached, "%", "peak, of Xmax"))
        if told.cost_s is not None:
            rows.append(Row(name, 1e3 * told.cost_s, "ms", "cost"))
        rows.append(Row(name, told.estimate, "", "predicted error"))
        if told.error is not None:
            rows.append(Row(name, told.error, "", "true error", Must("<=", TOLERANCE)))
    return Section(title, explanation, tuple(rows))


def _volts(vibration: FloatArray) -> FloatArray:
    """Return what drives the actuator, (frames,): each part at its level, with 0.2 s between."""
    part = round(PART_S * SAMPLERATE)
    level = np.repeat(list(LEVELS.values()), part)[: len(vibration)]
    width = round(CHANGE_S * SAMPLERATE)
    ramp = np.convolve(np.pad(level, width // 2, "edge"), np.full(width, 1.0 / width), "same")
    level = ramp[width // 2 : width // 2 + len(vibration)]
    raised = vibration * (level / np.abs(vibration).max())
    amplifier = replace(PAPER.amplifier, gain=GAIN)
    return Amplifier(amplifier, SAMPLERATE).drive(Dac(PAPER.dac).volts(raised))
