"""Second by second: the levels that were used, their cost, and the true error."""

import math
from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from device.rig import PAPER
from device.rig.adaptive_actuator import AdaptiveActuator, BlockReport
from device.rig.model_levels import ModelLevel
from tools.bench.measures.model_report import block_errors, report_seconds

TOLERANCE = 1e-2


def quiet_loud_quiet(samplerate, duration_s=3.0):
    times = np.arange(round(samplerate * duration_s)) / samplerate
    level = np.interp(times, [0.0, 1.0, 1.1, 2.0, 2.05, 3.0], [0.01, 0.01, 15.0, 15.0, 0.01, 0.01])
    return level * np.sin(math.tau * 70.0 * times)


def dearest(samplerate):
    return AdaptiveActuator(PAPER, samplerate, level=ModelLevel.NONLINEAR, nodes_hz=12_000.0)


# At 44.1 kHz a second is no whole number of nodes: some of its blocks are told in the next one.
@pytest.mark.parametrize("samplerate", [44_100, 48_000])
def test_each_second_says_its_models_and_keeps_the_tolerance(samplerate):
    adaptive = AdaptiveActuator(PAPER, samplerate, TOLERANCE)
    told = report_seconds(adaptive, quiet_loud_quiet(samplerate), reference=dearest(samplerate))
    assert [second.second for second in told] == [0, 1, 2]
    for second in told:
        assert second.frames == samplerate
        assert sum(second.shares.values()) == pytest.approx(1.0)
        assert second.error is not None
        assert second.error <= TOLERANCE
        assert second.estimate <= TOLERANCE
        assert second.cost_s is None
    first, loud, last = told
    assert first.shares[ModelLevel.LINEAR] > 0.9
    assert loud.shares[ModelLevel.NONLINEAR] > 0.5
    assert last.shares[ModelLevel.LINEAR] > 0.5
    assert loud.excursion_peak_m > 100 * first.excursion_peak_m


def test_without_a_dearest_model_and_a_clock_neither_error_nor_cost_is_claimed():
    told = report_seconds(
        AdaptiveActuator(PAPER, 48_000, TOLERANCE), quiet_loud_quiet(48_000, 1.25)
    )
    assert [second.frames for second in told] == [48_000, 12_000]
    assert all(second.error is None and second.cost_s is None for second in told)
    assert report_seconds(AdaptiveActuator(PAPER, 48_000), np.zeros(0)) == []


def test_the_cost_is_what_the_callers_clock_went_on_by_while_the_adaptive_actuator_worked():
    ticks = count(0.0, 0.25)  # a clock that goes on by a quarter of a second a look
    volts = quiet_loud_quiet(48_000)
    told = report_seconds(
        AdaptiveActuator(PAPER, 48_000, TOLERANCE),
        volts,
        clock=lambda: next(ticks),
        reference=dearest(48_000),
    )
    assert [second.cost_s for second in told] == [0.25, 0.25, 0.25]


def test_a_second_report_begins_at_rest_whatever_came_before():
    adaptive = AdaptiveActuator(PAPER, 48_000, TOLERANCE)
    volts = quiet_loud_quiet(48_000, 2.0)
    once = report_seconds(adaptive, volts, reference=dearest(48_000))
    adaptive.move(volts[:777])
    assert report_seconds(adaptive, volts, reference=dearest(48_000)) == once


def test_a_model_that_is_too_cheap_for_the_scene_is_shown_to_be_off():
    cheap = AdaptiveActuator(PAPER, 48_000, TOLERANCE, level=ModelLevel.LINEAR)
    told = report_seconds(cheap, quiet_loud_quiet(48_000), reference=dearest(48_000))
    assert told[1].shares[ModelLevel.LINEAR] == 1.0
    assert told[1].error is not None
    assert told[1].error > TOLERANCE


def test_a_blocks_error_is_the_larger_one_over_its_own_peak():
    volts = quiet_loud_quiet(48_000, 2.0)
    true = AdaptiveActuator(PAPER, 48_000, level=ModelLevel.LINEAR).move(volts)
    blocks = [
        BlockReport(frame, 4_800, ModelLevel.LINEAR, 0.0, 0.0)
        for frame in range(0, len(volts), 4_800)
    ]
    moved = replace(true, displacement_m=true.displacement_m.copy())
    moved.displacement_m[70_000] += 0.02 * np.abs(true.displacement_m[67_200:72_000]).max()
    errors = block_errors(blocks, 0, moved, true, PAPER.actuator)
    assert errors[14] == pytest.approx(0.02)
    assert np.count_nonzero(errors) == 1
