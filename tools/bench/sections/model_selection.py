"""Bench on the ladder: which rung each block took, what that cost, and whether it was enough."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from scipy.signal import butter, sosfilt

from audioflinger_hook.transform import FloatArray
from device.rig import PAPER
from device.rig.actuator import Motion
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.model_levels import ModelLevel
from device.rig.model_selection import FLOOR
from device.rig.report import block_errors
from tools.bench.cost import Timings, interleaved, thread_seconds
from tools.bench.report import Must, Row, Section
from tools.bench.sections.passivity import passive_rows
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Workbench

TITLE = "The ladder of rungs"
TOLERANCES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3)
NO_BLOCK = Must("<=", 0.0)
NO_CLICK = Must("<=", -80.0)

BURST_S = 0.25
FULL_V = 40.0
"""Loudest burst of one tone, V: at some frequencies it goes into the stops."""
FADED_ABOVE_HZ = 800.0
STEPPED_S = 0.1
REPEATS = 3


def ladder_of_rungs(bench: Workbench) -> Section:
    """ModelLevels used, cost and true error at several tolerances; clicks; energy from nowhere."""
    duration_s = bench.effort.rig_s
    volts = bursts(duration_s)
    true = AdaptiveActuator(PAPER, SAMPLERATE, level=ModelLevel.NONLINEAR, nodes_hz=24_000.0).move(
        volts
    )
    ladders = [AdaptiveActuator(PAPER, SAMPLERATE, tolerance) for tolerance in TOLERANCES]
    patient = [
        AdaptiveActuator(PAPER, SAMPLERATE, tolerance, early=False) for tolerance in TOLERANCES
    ]
    whole = AdaptiveActuator(PAPER, SAMPLERATE, level=ModelLevel.NONLINEAR)
    # What a block costs can be told from fewer blocks than how far the worst is off.
    timed_s = min(duration_s, bench.effort.rig_timed_s)
    timed = volts[: round(timed_s * SAMPLERATE)]
    works = [partial(_afresh, ladder, timed) for ladder in (*ladders, *patient, whole)]
    timings = interleaved(works, REPEATS)
    *timings, whole_timing = timings
    rows = []
    pairs = zip(timings[: len(ladders)], timings[len(ladders) :], strict=True)
    for ladder, (timing, patient_timing) in zip(ladders, pairs, strict=True):
        shares = shares_of_tolerance(ladder, volts, true)
        column = f"{ladder.tolerance:g}"
        beyond = int(np.count_nonzero(shares > 1.0))
        unit = f"of {shares.size}"
        rows.append(Row("blocks beyond the tolerance", beyond, unit, column, NO_BLOCK))
        rows.append(Row("worst block, of the tolerance", float(shares.max()), "", column))
        frames = sum(ladder.frames_by_level.values())
        for rung in (ModelLevel.LINEAR, ModelLevel.CORRECTED, ModelLevel.NONLINEAR):
            share = 100.0 * ladder.frames_by_level[rung] / frames
            rows.append(Row(f"{rung}, share of the time", share, "%", column))
        cost_ms = 1e3 * timing.median_s / timed_s
        rows.append(Row("a second of signal", cost_ms, "ms", column))
        for name, one in (
            ("cost, of all non-linear", timing),
            ("the same with an estimate of every block", patient_timing),
        ):
            rows.append(Row(name, _times(one, whole_timing), "times", column))
    all_ms = 1e3 * whole_timing.median_s / timed_s
    rows.append(Row("a second of signal", all_ms, "ms", "all non-linear"))
    for tolerance in TOLERANCES:
        clicks_db = _clicks_db(tolerance)
        rows.append(Row("clicks above 800 Hz", clicks_db, "dB", f"{tolerance:g}", NO_CLICK))
    rows += _stepped_rows()
    rows += passive_rows()
    return Section(
        TITLE,
        "Bursts of one tone, 20 to 220 Hz and from a whisper to beyond Xmax, with pauses in which "
        "the motion rings on; the ladder chooses block by block, at the tolerance over each "
        "column. A block's error is that of its excursion or of its acceleration, whichever is "
        "more: the largest difference from the non-linear rung at four times its rate, over the "
        f"block's peak or {FLOOR:g} of Xmax. All over {duration_s:g} s, but cost over the first "
        f"{timed_s:g} s, medians of {REPEATS} repeats.",
        tuple(rows),
        footnote="Energy from nowhere: what the amplifier let in during a step, less the heat, "
        "less what is stored more at its end; the non-linear rung on the drive of the section "
        "above, the step by step rung on white noise of 60 V.",
    )


def bursts(duration_s: float) -> FloatArray:
    """The volts, (frames,): burst after burst, each with its own tone and level, some silent."""
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
    """The median of the ratios within each round."""
    return float(np.median(np.array(one.seconds) / np.array(other.seconds)))


def _afresh(ladder: AdaptiveActuator, volts: FloatArray) -> None:
    ladder.reset()
    ladder.move(volts)


def shares_of_tolerance(ladder: AdaptiveActuator, volts: FloatArray, true: Motion) -> FloatArray:
    """Each block's true error as a share of the tolerance, (blocks,), from rest."""
    ladder.reset()
    motion = ladder.move(volts)
    errors = block_errors(ladder.reports, 0, motion, true, ladder.rig.actuator)
    return errors / ladder.tolerance


def _clicks_db(tolerance: float) -> float:
    """What switches leave above 800 Hz, of two tones that have nothing there by themselves."""
    times = np.arange(round(1.6 * SAMPLERATE)) / SAMPLERATE
    envelope = 0.4 + 3.0 * np.sin(math.pi * times / 1.6) ** 2
    volts = envelope * (np.sin(math.tau * 46.6 * times) + np.sin(math.tau * 92.0 * times))
    motion = AdaptiveActuator(PAPER, SAMPLERATE, tolerance).move(volts).acceleration_m_s2
    high = butter(8, FADED_ABOVE_HZ, "high", fs=SAMPLERATE, output="sos")
    left = sosfilt(high, motion)[2_000:-2_000]
    return 20.0 * math.log10(float(np.abs(left).max() / np.abs(motion).max()))


def _stepped_rows() -> list[Row]:
    """What the step by step rung costs."""
    volts = bursts(4 * BURST_S)[: round(STEPPED_S * SAMPLERATE)] + 5.0
    ladder = AdaptiveActuator(PAPER, SAMPLERATE, level=ModelLevel.STEPPED)
    cost = thread_seconds(partial(_afresh, ladder, volts)) / STEPPED_S
    return [Row("step by step, a second of signal", 1e3 * cost, "ms", "all non-linear")]
