"""The sections on the rig."""

from dataclasses import replace

import numpy as np
import pytest

from device.rig import PAPER
from device.rig.adaptive_actuator import AdaptiveActuator, BlockReport
from tools.bench.sections import scaling
from tools.bench.sections.model_selection import block_errors
from tools.bench.workbench import QUICK, SUBJECTS, Workbench

LEAST = Workbench(replace(QUICK, rig_s=1.0), SUBJECTS, ())


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
    true = AdaptiveActuator(PAPER, 48_000, model="linear").move(volts)
    blocks = [BlockReport(frame, 4_800, "linear", 0.0) for frame in range(0, len(volts), 4_800)]
    moved = true._replace(displacement_m=true.displacement_m.copy())
    moved.displacement_m[70_000] += 0.02 * np.abs(true.displacement_m[67_200:72_000]).max()
    errors = block_errors(blocks, moved, true, PAPER.actuator)
    assert errors[14] == pytest.approx(0.02)
    assert np.count_nonzero(errors) == 1
