"""Bench on the ladder: second by second what it used, what that cost, and the true error."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from audioflinger_hook.transform import FloatArray
from device.rig import PAPER
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.electronics import Amplifier, Dac
from device.rig.model_levels import ModelLevel
from device.rig.report import SecondReport, report_seconds
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import SAMPLERATE, looped, speech
from tools.bench.workbench import LIVE, Workbench

TOLERANCE = 1e-2
PART_S = 2.0
LEVELS = {"quiet": 0.02, "loud": 1.0, "quiet again": 0.02}
"""Peak of the vibration in each part, full scale being 1."""
TRUE_NODES_HZ = 24_000.0
CHANGE_S = 0.2
GAIN = 10.0
"""The amplifier turned up by 12 dB: to a third of Xmax."""


def rungs_by_second(bench: Workbench) -> Section:
    """The report of one run over recorded speech that is quiet, loud and quiet."""
    parts = tuple(LEVELS)
    title = "The ladder, second by second"
    explanation = (
        f"Recorded speech through the transform, DAC and amplifier of the `{PAPER.name}` rig, "
        f"turned up to a gain of {GAIN:g}: {PART_S:g} s each {', '.join(parts)}. Tolerance "
        f"{TOLERANCE:g}. Shares of the time by rung, the largest error that the ladder foretold in "
        "a block of that second, and the true one, against the non-linear rung at four times its "
        "rate."
    )
    sound = speech(bench.recordings)
    if sound is None:
        missing = bench.missing_recordings("a run second by second")
        return Section(title, explanation, (), (missing,))
    whole = looped(sound, PART_S * len(parts))
    volts = _volts(bench.subject(LIVE).vibration(whole, SAMPLERATE))
    seconds = report_seconds(
        AdaptiveActuator(PAPER, SAMPLERATE, TOLERANCE),
        volts,
        clock=time.thread_time,
        reference=AdaptiveActuator(
            PAPER, SAMPLERATE, level=ModelLevel.NONLINEAR, nodes_hz=TRUE_NODES_HZ
        ),
    )
    rows = []
    for told in seconds:
        name = f"{told.second} to {told.second + 1} s, {parts[int(told.second // PART_S)]}"
        rows += _rows(name, told)
    return Section(title, explanation, tuple(rows))


def _volts(vibration: FloatArray) -> FloatArray:
    """What drives the actuator, (frames,): each part at its level, its ends 0.2 s long."""
    part = round(PART_S * SAMPLERATE)
    level = np.repeat(list(LEVELS.values()), part)[: len(vibration)]
    width = round(CHANGE_S * SAMPLERATE)
    ramp = np.convolve(np.pad(level, width // 2, "edge"), np.full(width, 1.0 / width), "same")
    level = ramp[width // 2 : width // 2 + len(vibration)]
    raised = vibration * (level / np.abs(vibration).max())
    amplifier = replace(PAPER.amplifier, gain=GAIN)
    return Amplifier(amplifier, SAMPLERATE).drive(Dac(PAPER.dac).volts(raised))


def _rows(name: str, told: SecondReport) -> list[Row]:
    rows = [
        Row(name, 100.0 * told.shares[rung], "%", f"{rung}")
        for rung in (ModelLevel.LINEAR, ModelLevel.CORRECTED, ModelLevel.NONLINEAR)
    ]
    reached = 100.0 * told.excursion_peak_m / PAPER.actuator.x_max_m
    rows.append(Row(name, reached, "%", "peak, of Xmax"))
    if told.cost_s is not None:
        rows.append(Row(name, 1e3 * told.cost_s, "ms", "cost"))
    rows.append(Row(name, told.estimate, "", "error foretold"))
    if told.error is not None:
        rows.append(Row(name, told.error, "", "true error", Must("<=", TOLERANCE)))
    return rows
