"""Rigs: what follows from their parameters, and which parameters are refused."""

import math
from dataclasses import asdict, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.errors import UsageError
from device.rig import CONSUMER, PAPER, rig_by_name
from device.rig.parameters import detune

ACTUATOR = PAPER.actuator


@pytest.mark.parametrize(
    ("actuator", "electrical", "total"),
    [
        (PAPER.actuator, 4.67, 2.95),
        (replace(PAPER.actuator, force_factor_n_per_a=16.0), 1.82, 1.48),
        (CONSUMER.actuator, 5.91, 2.71),
    ],
)
def test_actuators_have_the_quality_factors_that_their_tables_state(actuator, electrical, total):
    assert actuator.q_electrical() == pytest.approx(electrical, abs=0.005)
    assert actuator.q_total() == pytest.approx(total, abs=0.005)


def test_stiffness_and_damping_give_back_resonance_and_quality_and_follow_a_detuned_rig():
    mass, stiffness = ACTUATOR.moving_mass_kg, ACTUATOR.stiffness_n_per_m
    assert math.sqrt(stiffness / mass) / math.tau == pytest.approx(90.0, rel=1e-14)
    quality = math.sqrt(stiffness * mass) / ACTUATOR.damping_n_s_per_m
    assert quality == pytest.approx(8.0, rel=1e-14)
    rig = detune(ACTUATOR, -0.1)
    assert rig.resonance_hz == pytest.approx(81.0)
    assert rig.moving_mass_kg == ACTUATOR.moving_mass_kg
    assert rig.damping_n_s_per_m == pytest.approx(ACTUATOR.damping_n_s_per_m, rel=1e-12)


@given(st.floats(0, 1e9))
def test_a_source_impedance_damps_less(source_impedance_ohm):
    total = ACTUATOR.q_total(source_impedance_ohm)
    assert ACTUATOR.q_total() <= total <= ACTUATOR.q_mechanical


def test_a_rig_is_found_by_its_name_only():
    assert rig_by_name("paper") is PAPER
    assert rig_by_name("consumer") is CONSUMER
    with pytest.raises(UsageError, match="no rig is named 'Paper'; choose one of: paper"):
        rig_by_name("Paper")


@pytest.mark.parametrize(
    ("stage", "name", "value"),
    [
        *(
            (PAPER.actuator, name, value)
            for name in asdict(PAPER.actuator)
            for value in (0.0, -1.0, math.nan, math.inf)
            if value != 0.0 or "eddy" not in name  # a coil may have no eddy currents
        ),
        *((PAPER.dac, "bits", value) for value in (7, 33, 16.5)),
        (PAPER.dac, "full_scale_v", 0.0),
        (PAPER.amplifier, "gain", 0.0),
        (PAPER.amplifier, "output_limit_v", math.inf),
        (PAPER.amplifier, "source_impedance_ohm", -0.1),
    ],
)
def test_no_stage_has_a_parameter_that_is_not_physical(stage, name, value):
    with pytest.raises(UsageError, match=f"{name}={value}"):
        replace(stage, **{name: value})
