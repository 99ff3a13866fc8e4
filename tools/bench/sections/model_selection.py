"""Sections on the models: which one each block took, its cost and true error; and rough drives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.signal import butter, sosfilt

from audioflinger_hook.transform import FloatArray
from device.rig import PAPER, Rig
from device.rig.actuator import Motion
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.model_levels import BlockReport, ModelLevel
from device.rig.nonlinear_model import FLOOR
from device.rig.parameters import ActuatorParameters
from tools.bench.cost import Timings, in_ffts, interleaved
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Workbench

TOLERANCES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3)
MODELS = (ModelLevel.LINEAR, ModelLevel.NONLINEAR)
NO_BLOCK = Must("<=", 0.0)
NO_CLICK = Must("<=", -80.0)
OWN_COST = Must("<=", 1.1)
EXCURSION = Must("<=", 1e-4)
SELECTED_MS = Must("<=", 1.05)
"""Of a second of bursts, silence or quiet music: 0.15 of a non-linear model in NumPy, 7 ms."""
BURST_S = 0.25
FULL_V = 40.0
"""Loudest burst of one tone: at some frequencies the actuator reaches its stops."""
FADED_ABOVE_HZ = 800.0
REPEATS = 5
TRUE_STEPS = 1e-6
TIMED_TOLERANCE = 1e-2
QUIET = ("80 % silence", "quiet music")


def model_selection(bench: Workbench) -> Section:
    """Models used, cost and true error at several tolerances, and clicks at switches."""
    duration_s = bench.effort.rig_s
    volts = bursts(duration_s)
    true = truth(PAPER, volts)
    selecting = [AdaptiveActuator(PAPER, SAMPLERATE, tolerance) for tolerance in TOLERANCES]
    whole = AdaptiveActuator(PAPER, SAMPLERATE, level=ModelLevel.NONLINEAR)
    timed_s = min(duration_s, bench.effort.rig_timed_s)
    timed = volts[: round(timed_s * SAMPLERATE)]
    works = [partial(_afresh, rig, timed) for rig in (*selecting, whole)]
    *timings, whole_timing = interleaved(works, REPEATS)
    rows = []
    for rig, timing in zip(selecting, timings, strict=True):
        shares = shares_of_tolerance(rig, volts, true)
        beyond = float(np.count_nonzero(shares > 1.0))
        frames = sum(rig.frames_by_level.values())
        column = f"{rig.tolerance:g}"
        rows += [
            Row("blocks beyond the tolerance", beyond, f"of {shares.size}", column, NO_BLOCK),
            Row("worst block, of the tolerance", float(shares.max()), "", column),
        ]
        for model in MODELS:
            share = 100.0 * rig.frames_by_level[model] / frames
            rows.append(Row(f"{model}, share of the time", share, "%", column))
        rows += [
            *_second(
                "a second of signal",
                column,
                timing,
                timed_s,
                limited=rig.tolerance == TIMED_TOLERANCE,
            ),
            Row("cost, of all non-linear", _times(timing, whole_timing), "times", column, OWN_COST),
            Row("clicks above 800 Hz", _clicks_db(rig.tolerance), "dB", column, NO_CLICK),
        ]
    all_ms = 1e3 * whole_timing.median_s / timed_s
    rows.append(Row("a second of signal", all_ms, "ms", "all non-linear"))
    return Section(
        "Model selection",
        "Bursts of one tone of 20 to 220 Hz, from faint to beyond Xmax, with pauses in which the "
        "motion rings on. The rig selects a model for each block, at the tolerance over each "
        "column. The reference is the non-linear model with steps that may be off by "
        f"{TRUE_STEPS:g}. A block's error is the largest difference of excursion or acceleration, "
        f"over the block's peak or {FLOOR:g} of Xmax. Errors over {duration_s:g} s, costs over the "
        f"first {timed_s:g} s, medians of {REPEATS} repeats.",
        tuple(rows),
    )


def drives_and_scenes(bench: Workbench) -> Section:
    """Cost and error of the non-linear model, and of the selection, from scene to scene."""
    duration_s = bench.effort.rig_timed_s
    rows = []
    for name, (rig, volts) in scenes(duration_s).items():
        true = truth(rig, volts)
        whole = AdaptiveActuator(rig, SAMPLERATE, level=ModelLevel.NONLINEAR)
        chosen = AdaptiveActuator(rig, SAMPLERATE, TIMED_TOLERANCE)
        works = [partial(_afresh, each, volts) for each in (whole, chosen)]
        timings = interleaved(works, REPEATS)
        whole.reset()
        excursion_m = whole.move(volts).displacement_m
        peak_m = float(np.abs(true.displacement_m).max())
        error = float(np.abs(excursion_m - true.displacement_m).max()) / peak_m
        shares = shares_of_tolerance(chosen, volts, true)
        ratio = _times(timings[1], timings[0])
        selected = f"selected at {TIMED_TOLERANCE:g}, a second"
        rows += [
            Row(name, 1e3 * timings[0].median_s / duration_s, "ms", "non-linear, a second"),
            Row(name, error, "", "error of its excursion", EXCURSION),
            *_second(name, selected, timings[1], duration_s, limited=name in QUIET),
            Row(name, ratio, "times", "of the non-linear", OWN_COST),
            Row(name, float(shares.max()), "", "worst block, of the tolerance", Must("<=", 1.0)),
        ]
    return Section(
        "Scenes and rough drives",
        f"The same for {duration_s:g} s each of other drives of the `paper` rig. Hard stops are "
        "800 times as stiff as its own.",
        tuple(rows),
    )


def truth(rig: Rig, volts: FloatArray) -> Motion:
    """Return the motion by much shorter steps."""
    return AdaptiveActuator(
        rig, SAMPLERATE, level=ModelLevel.NONLINEAR, step_tolerance=TRUE_STEPS
    ).move(volts)


def scenes(duration_s: float) -> dict[str, tuple[Rig, FloatArray]]:
    """Return rigs and volts, (frames,), by name."""
    random = np.random.default_rng(7)
    times = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    tone = np.sin(math.tau * 80.0 * times)
    noise = random.standard_normal(times.size)
    band = sosfilt(butter(2, [20.0, 220.0], "band", fs=SAMPLERATE, output="sos"), noise)
    music = band / np.abs(band).max() * (0.3 + 0.7 * np.abs(np.sin(math.tau * 0.7 * times)) ** 3)
    squares = np.sign(np.sin(math.tau * 90.0 * times + 1e-9))
    quarter = np.floor(times / BURST_S).astype(int)
    large = PAPER.large_signal
    hard = replace(PAPER, large_signal=large and replace(large, stop_n_per_m2=1e12))
    small = replace(PAPER, actuator=replace(PAPER.actuator, inductance_h=1e-6))
    return {
        "80 % silence": (PAPER, bursts(duration_s) * (quarter % 5 == 0)),
        "quiet music": (PAPER, 0.7 * music),
        "loud music": (PAPER, 15.0 * music),
        "squares of 15 V": (PAPER, 15.0 * squares),
        "white noise of 20 V": (PAPER, 20.0 * noise),
        "into the stops, 60 V": (PAPER, 60.0 * tone),
        "hard stops, 100 V": (hard, 100.0 * tone),
        "inductance of 1 uH": (small, 8.0 * tone),
    }


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


def _second(name: str, column: str, timing: Timings, timed_s: float, *, limited: bool) -> list[Row]:
    """Return the cost of a second in ms, and in FFTs where it has a limit."""
    middle_ms = 1e3 * timing.median_s / timed_s
    if not limited:
        return [Row(name, middle_ms, "ms", column)]
    ffts = f"{column}, FFTs"
    limit = Must("<=", in_ffts(1e-3 * SELECTED_MS.bound))
    return [
        Row(name, middle_ms, "ms", column, SELECTED_MS, ffts_column=ffts),
        Row(name, round(timing.median_units / timed_s), "FFTs", ffts, limit),
    ]


def _times(one: Timings, other: Timings) -> float:
    """Return the median of the ratios within each round."""
    return float(np.median(np.array(one.seconds) / np.array(other.seconds)))


def _afresh(rig: AdaptiveActuator, volts: FloatArray) -> None:
    rig.reset()
    rig.move(volts)


def shares_of_tolerance(rig: AdaptiveActuator, volts: FloatArray, true: Motion) -> FloatArray:
    """Return each block's true error as a share of the tolerance, (blocks,), from rest."""
    rig.reset()
    motion = rig.move(volts)
    return block_errors(rig.reports, motion, true, rig.rig.actuator) / rig.tolerance


def block_errors(
    blocks: Sequence[BlockReport], motion: Motion, true: Motion, actuator: ActuatorParameters
) -> FloatArray:
    """Return the true error of each block, (blocks,): the larger of excursion and acceleration.

    An error is the largest difference as a share of the block's true peak, or of the peak at 1 %
    of Xmax where the block moves less.
    """
    floor_m = FLOOR * actuator.x_max_m
    floors = {"displacement_m": floor_m, "acceleration_m_s2": floor_m * actuator.resonance_rad_s**2}
    errors = np.zeros(len(blocks))
    for index, block in enumerate(blocks):
        part = slice(block.frame, block.frame + block.frames)
        for name, floor in floors.items():
            expected: FloatArray = getattr(true, name)[part]
            error = float(np.abs(getattr(motion, name)[part] - expected).max(initial=0.0))
            peak = max(float(np.abs(expected).max(initial=0.0)), floor)
            errors[index] = max(errors[index], error / peak)
    return errors


def _clicks_db(tolerance: float) -> float:
    """Return what switching leaves above 800 Hz of two tones that have nothing there."""
    times = np.arange(round(1.6 * SAMPLERATE)) / SAMPLERATE
    envelope = 0.4 + 3.0 * np.sin(math.pi * times / 1.6) ** 2
    volts = envelope * (np.sin(math.tau * 46.6 * times) + np.sin(math.tau * 92.0 * times))
    motion = AdaptiveActuator(PAPER, SAMPLERATE, tolerance).move(volts).acceleration_m_s2
    high = butter(8, FADED_ABOVE_HZ, "high", fs=SAMPLERATE, output="sos")
    left = sosfilt(high, motion)[2_000:-2_000]
    return 20.0 * math.log10(float(np.abs(left).max() / np.abs(motion).max()))
