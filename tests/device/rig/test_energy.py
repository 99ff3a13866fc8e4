"""Shapes and co-energy: exact derivatives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.rig import CONSUMER, PAPER
from device.rig.co_energy import energies
from device.rig.shapes import Arctangent, Hardening, Line, Stops, Sum, Tanh
from tests.support.co_energy import co_energy_j, flux_linkage_wb, stored_energy_j

PAPERS = energies(PAPER.actuator, PAPER.large_signal)
X_MAX = PAPER.actuator.x_max_m
SHAPES = [
    Line(10.0),
    Hardening(8e4, 2e10),
    Arctangent(10.0, 2.6e-3),
    Tanh(1e-3, 0.3, 1.5e-3),
    Stops(2.2e-3, 1.3e9),
    Sum((Hardening(8e4, 2e10), Stops(2.2e-3, 1.3e9))),
]
NAMES = ["line", "hardening", "arctangent", "tanh", "stops", "sum"]
EXCURSIONS = st.floats(-3e-3, 3e-3)


def scale(shape):
    """The largest slope of a shape over all excursions."""
    return float(np.abs(shape.jet(np.linspace(-3e-3, 3e-3, 101))[1]).max())


# -------------------------------------------------------------------------------------- shapes


@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
def test_each_derivative_of_a_shape_is_the_slope_of_the_one_before(shape):
    x = np.linspace(-2.9e-3, 2.9e-3, 801)
    step = 1e-7
    before, after, here = shape.jet(x - step), shape.jet(x + step), shape.jet(x)
    for order in range(2):
        slope = (after[order] - before[order]) / (2 * step)
        # Central differences: (step / 1.5 mm)^2 = 4e-9, and rounding of the difference, 1e-16
        # of 3 mm over the step, 3e-12; where a stop begins f''' jumps, and the slope is off by
        # one step of f''.
        allowed = 1e-7 * np.abs(slope).max() + step * 2 * getattr(shape, "hardness", 2.6e9)
        assert np.abs(slope - here[order + 1]).max() <= allowed


@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
@given(EXCURSIONS, EXCURSIONS)
def test_a_divided_difference_times_the_way_is_the_difference(shape, a, b):
    difference = shape.value(b) - shape.value(a)
    # Rounding of the two values themselves.
    rounding = 4e-16 * (abs(shape.value(a)) + abs(shape.value(b)))
    divided = shape.divided(a, b)
    assert divided * (b - a) == pytest.approx(difference, rel=1e-12, abs=rounding + 1e-30)
    assert shape.divided(b, a) == pytest.approx(divided, rel=1e-12, abs=1e-12 * scale(shape))


@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
@given(EXCURSIONS, st.floats(-1e-12, 1e-12))
def test_where_the_ends_meet_a_divided_difference_is_the_derivative(shape, a, way):
    slope = float(shape.jet(np.array([a]))[1][0])
    # The slope changes by f'' times the way: 1e-9 of its scale at 1e-12 of 1 mm.
    assert shape.divided(a, a + way) == pytest.approx(slope, rel=1e-9, abs=1e-8 * scale(shape))
    assert shape.divided(a, a) == pytest.approx(slope, rel=1e-12, abs=1e-13 * scale(shape))


@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
@given(EXCURSIONS)
def test_one_value_is_the_same_as_one_of_many(shape, x):
    expected = float(shape.jet(np.array([x]))[0][0])
    assert shape.value(x) == pytest.approx(expected, rel=1e-13, abs=1e-300)


# ------------------------------------------------------------------------------------ co-energy


@given(EXCURSIONS, st.floats(-7, 7))
def test_force_flux_and_inductance_are_the_derivatives_of_the_co_energy(x, i):
    w = PAPERS.co_energy
    dx, di = 1e-6, 1e-4
    xs, i_s = np.array([x - dx, x, x + dx]), np.array([i - di, i, i + di])
    by_x, by_i = co_energy_j(w, xs, np.full(3, i)), co_energy_j(w, np.full(3, x), i_s)
    flux = flux_linkage_wb(w, np.full(3, x), i_s)
    at = w.at(np.array([x]), flux[1:2])
    # Second order in a step of 1e-3 of Xmax; W' is quadratic in i, there only rounding is left.
    assert (by_x[2] - by_x[0]) / (2 * dx) == pytest.approx(at.force_n[0], abs=1e-5 * 80)
    assert (by_i[2] - by_i[0]) / (2 * di) == pytest.approx(flux[1], abs=1e-10)
    assert (flux[2] - flux[0]) / (2 * di) == pytest.approx(at.inductance_h[0], rel=1e-9)
    assert at.current_a[0] == pytest.approx(i, abs=1e-12)


@given(EXCURSIONS, st.floats(-7, 7))
def test_the_flux_changes_with_the_excursion_as_the_force_does_with_the_current(x, i):
    w = PAPERS.co_energy
    dx, di = 1e-6, 1e-4
    flux = flux_linkage_wb(w, np.array([x - dx, x + dx]), np.array([i, i]))
    same, currents = np.full(3, x), np.array([i - di, i, i + di])
    at = w.at(same, flux_linkage_wb(w, same, currents))
    force, both = at.force_n[[0, 2]], float(at.flux_slope[1])
    assert (flux[1] - flux[0]) / (2 * dx) == pytest.approx(both, abs=1e-5)
    assert (force[1] - force[0]) / (2 * di) == pytest.approx(both, abs=1e-8)


@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=lambda rig: rig.name)
def test_at_x_max_the_shapes_have_changed_as_the_table_of_the_rig_says(rig):
    e = energies(rig.actuator, rig.large_signal)
    x = np.array([0.0, rig.actuator.x_max_m, -rig.actuator.x_max_m])
    nothing = np.zeros(3)
    at = e.co_energy.at(x, flux_linkage_wb(e.co_energy, x, nothing))
    assert at.flux_slope / rig.actuator.force_factor_n_per_a == pytest.approx([1.0, 0.75, 0.75])
    stiffness = e.potential.jet(x)[1][1:] / x[1:]
    assert stiffness / rig.actuator.stiffness_n_per_m == pytest.approx([1.5, 1.5])
    inductance = at.inductance_h / rig.actuator.inductance_h
    assert inductance == pytest.approx([1.0, 0.77, 1.23], abs=0.002)


@given(EXCURSIONS, st.floats(-7, 7))
def test_the_stored_energy_is_never_negative(x, i):
    assert stored_energy_j(PAPERS, np.array([x]), np.array([i]))[0] >= 0.0
