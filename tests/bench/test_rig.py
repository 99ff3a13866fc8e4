"""The sections on the rig, and the energy balance of its models."""

from dataclasses import replace

import numpy as np
import pytest

from device.rig import PAPER
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.model_levels import BlockReport, ModelLevel
from tests.support import energy_balance
from tools.bench.sections import scaling
from tools.bench.sections.model_selection import block_errors
from tools.bench.sections.rig import LEVEL_V, drive
from tools.bench.workbench import QUICK, SUBJECTS, Workbench

LEAST = Workbench(replace(QUICK, rig_s=1.0), SUBJECTS, ())


def test_below_the_stops_no_step_makes_more_than_a_millionth_of_the_energy():
    assert energy_balance.worst_step(drive(0.4, LEVEL_V), 3e-6) <= 1e-6


def test_the_usual_steps_make_no_more_than_their_current_is_off_between_nodes():
    # Half a ten-thousandth of the current, from node to node; over many steps it cancels.
    assert energy_balance.worst_step(drive(0.4, LEVEL_V)) <= 5e-5


def test_no_step_of_the_step_by_step_model_makes_energy_even_of_noise():
    assert energy_balance.worst_step_of_noise() <= 1e-10


def test_heat_that_is_missed_would_be_an_energy_balance_error(monkeypatch):
    heat_w = energy_balance._heat_w
    monkeypatch.setattr(energy_balance, "_heat_w", lambda *at: 0.999 * heat_w(*at))
    assert energy_balance.worst_step(drive(0.4, LEVEL_V), 3e-6) > 1e-6


def test_the_integral_over_a_step_is_exact_for_parabolas():
    times = np.arange(17) / 48_000
    (got,) = energy_balance._over_steps(3.0 + times + times**2, np.array([0, 16]), 48_000)
    end = times[16]
    assert got == pytest.approx(3.0 * end + end**2 / 2.0 + end**3 / 3.0, rel=1e-12)


@pytest.mark.exhaustive
def test_growth_is_told_as_ratios_of_one_run_with_an_exponent_each():
    section = scaling.rig_scaling(LEAST)
    columns = {row.column for row in section.rows}
    assert len(columns) == 3
    for column in columns:
        rows = {row.name: row for row in section.rows if row.column == column}
        assert rows["sample rate: 48 kHz"].value == 1.0
        assert rows["number of actuators: 1, each"].value == 1.0
        limited = {name for name, row in rows.items() if row.must}
        assert limited == {"duration: exponent", "number of actuators: exponent"}


def test_an_exponent_is_that_of_the_costs():
    sizes = [1.0, 2.0, 4.0]
    assert scaling.exponent(sizes, [3.0, 6.0, 12.0]) == pytest.approx(1.0)
    assert scaling.exponent(sizes, [3.0, 12.0, 48.0]) == pytest.approx(2.0)


def test_a_blocks_error_is_the_larger_one_over_its_own_peak():
    times = np.arange(96_000) / 48_000
    volts = 5.0 * np.sin(np.pi * times) ** 2 * np.sin(2 * np.pi * 70.0 * times)
    true = AdaptiveActuator(PAPER, 48_000, level=ModelLevel.LINEAR).move(volts)
    blocks = [
        BlockReport(frame, 4_800, ModelLevel.LINEAR, 0.0, 0.0)
        for frame in range(0, len(volts), 4_800)
    ]
    moved = replace(true, displacement_m=true.displacement_m.copy())
    moved.displacement_m[70_000] += 0.02 * np.abs(true.displacement_m[67_200:72_000]).max()
    errors = block_errors(blocks, moved, true, PAPER.actuator)
    assert errors[14] == pytest.approx(0.02)
    assert np.count_nonzero(errors) == 1
