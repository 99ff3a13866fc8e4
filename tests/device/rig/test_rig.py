"""Rigs: what follows from their parameters, and which parameters are refused."""

import math
from dataclasses import FrozenInstanceError, asdict, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.errors import UsageError
from device.rig import PAPER, ActuatorParameters, rig_by_name


def test_the_papers_actuator_has_the_quality_factors_that_its_table_states():
    actuator = PAPER.actuator
    assert actuator.q_electrical() == pytest.approx(4.67, abs=0.005)
    assert actuator.q_total() == pytest.approx(2.95, abs=0.005)
    stronger = replace(actuator, force_factor_n_per_a=16.0)
    assert stronger.q_electrical() == pytest.approx(1.82, abs=0.005)
    assert stronger.q_total() == pytest.approx(1.48, abs=0.005)


def test_stiffness_and_damping_give_back_resonance_and_quality():
    actuator = PAPER.actuator
    mass, stiffness = actuator.moving_mass_kg, actuator.stiffness_n_per_m
    assert math.sqrt(stiffness / mass) / math.tau == pytest.approx(90.0, rel=1e-14)
    quality = math.sqrt(stiffness * mass) / actuator.damping_n_s_per_m
    assert quality == pytest.approx(8.0, rel=1e-14)


@given(st.floats(0, 1e9))
def test_a_source_impedance_damps_less(source_impedance_ohm):
    actuator = PAPER.actuator
    total = actuator.q_total(source_impedance_ohm)
    assert actuator.q_total() <= total <= actuator.q_mechanical


def test_a_rig_is_found_by_its_name_only():
    assert rig_by_name("paper") is PAPER
    with pytest.raises(UsageError, match="no rig is named 'Paper'; choose one of: paper"):
        rig_by_name("Paper")


def test_all_wrong_parameters_are_named_at_once():
    values = asdict(PAPER.actuator) | {"moving_mass_kg": -0.25, "q_mechanical": 0.0}
    with pytest.raises(UsageError) as caught:
        ActuatorParameters(**values | {"x_max_m": math.nan})
    assert str(caught.value) == (
        "Actuator of the rig: moving_mass_kg=-0.25 must be above 0; q_mechanical=0.0 must be "
        "above 0; x_max_m=nan must be above 0; correct the rig"
    )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (name, value)
        for name in asdict(PAPER.actuator)
        for value in (0.0, -1.0, math.nan, math.inf)
        if value != 0.0 or "eddy" not in name  # a coil may have no eddy currents
    ],
)
def test_no_actuator_has_a_parameter_that_is_not_physical(name, value):
    with pytest.raises(UsageError, match=f"{name}={value}"):
        replace(PAPER.actuator, **{name: value})


@pytest.mark.parametrize(
    ("stage", "name", "value"),
    [
        (PAPER.dac, "bits", 7),
        (PAPER.dac, "bits", 33),
        (PAPER.dac, "bits", 16.5),
        (PAPER.dac, "full_scale_v", 0.0),
        (PAPER.amplifier, "gain", 0.0),
        (PAPER.amplifier, "output_limit_v", math.inf),
        (PAPER.amplifier, "source_impedance_ohm", -0.1),
    ],
)
def test_no_dac_and_no_amplifier_either(stage, name, value):
    with pytest.raises(UsageError, match=f"{name}={value}"):
        replace(stage, **{name: value})


def test_parameters_do_not_change():
    with pytest.raises(FrozenInstanceError):
        PAPER.dac.bits = 16  # type: ignore[misc]
