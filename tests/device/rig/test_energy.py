"""Shapes and energies: exact derivatives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.rig import CONSUMER, PAPER
from device.rig.co_energy import Arctangent, Hardening, Line, Stops, Tanh, energies
from tests.support.co_energy import stored_energy_j

PAPERS = energies(PAPER.actuator, PAPER.large_signal)
SHAPES = [
    Line(10.0),
    Hardening(8e4, 2e10),
    Arctangent(10.0, 2.6e-3),
    Tanh(1e-3, 0.3, 1.5e-3),
    Stops(2.2e-3, 1.3e9),
]
NAMES = ["line", "hardening", "arctangent", "tanh", "stops"]
EXCURSIONS = st.floats(-3e-3, 3e-3)


# -------------------------------------------------------------------------------------- shapes


@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
def test_each_derivative_of_a_shape_is_the_slope_of_the_one_before(shape):
    x = np.linspace(-2.9e-3, 2.9e-3, 801)
    step = 1e-7
    before, after, here = shape(x - step), shape(x + step), shape(x)
    for order in range(2):
        slope = (after[order] - before[order]) / (2 * step)
        # Central differences: (step / 1.5 mm)^2 = 4e-9, and rounding of the difference, 1e-16
        # of 3 mm over the step, 3e-12; where a stop begins f''' jumps, and the slope is off by
        # one step of f''.
        allowed = 1e-7 * np.abs(slope).max() + step * 2 * getattr(shape, "hardness", 2.6e9)
        assert np.abs(slope - here[order + 1]).max() <= allowed


# ----------------------------------------------------------------------------------- energies


@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=lambda rig: rig.name)
def test_at_x_max_the_shapes_have_changed_as_the_table_of_the_rig_says(rig):
    e = energies(rig.actuator, rig.large_signal)
    x = np.array([0.0, rig.actuator.x_max_m, -rig.actuator.x_max_m])
    force_factor = e.magnet(x)[1] / rig.actuator.force_factor_n_per_a
    assert force_factor == pytest.approx([1.0, 0.75, 0.75])
    stiffness = e.spring(x)[1][1:] / x[1:]
    assert stiffness / rig.actuator.stiffness_n_per_m == pytest.approx([1.5, 1.5])
    inductance = e.inductance(x)[0] / rig.actuator.inductance_h
    assert inductance == pytest.approx([1.0, 0.77, 1.23], abs=0.002)


@given(EXCURSIONS, st.floats(-7, 7))
def test_the_stored_energy_is_never_negative(x, i):
    assert stored_energy_j(PAPERS, np.array([x]), np.array([i]))[0] >= 0.0
