import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import StateSpace, lsim

from device import blocks
from device.errors import UsageError
from device.rig import PAPER
from device.rig.actuator import QUANTITIES, LinearActuator

ACTUATOR = PAPER.actuator
UNDAMPED = {"q_mechanical": 1_000.0, "force_factor_n_per_a": 0.5}  # Qts stays near 1000
STIFF = {"inductance_h": 1e-6}  # L/R is 0.3 us, far below a sample
OVERDAMPED = {"force_factor_n_per_a": 60.0, "inductance_h": 1e-4}  # three real poles
CASES = {"paper": {}, "Q 1000": UNDAMPED, "1 uH": STIFF, "Q 1000 and 1 uH": UNDAMPED | STIFF}
CASES |= {"overdamped": OVERDAMPED, "10 Hz": {"resonance_hz": 10.0}}
PARAMETERS = [replace(ACTUATOR, **changes) for changes in CASES.values()]
RATES = [1_000, 8_000, 48_000, 192_000]
EXTREMES = [math.nan, math.inf, -math.inf, 1.7e308, -1e101, 1e100, -1e100, 1e30, 5e-324, -0.0]


ANY = st.lists(st.sampled_from(EXTREMES) | st.floats(), max_size=300).map(np.array)


def physics(p, source_impedance_ohm):
    """(rate, drive, outputs) of s' = rate s + drive v with s = (x, x', i), outputs as QUANTITIES.

    Written from the equations of motion in plain units, apart from the code under test.
    """
    m, bl, inductance = p.moving_mass_kg, p.force_factor_n_per_a, p.inductance_h
    w0 = math.tau * p.resonance_hz
    resistance = p.resistance_ohm + source_impedance_ohm
    force = [-(w0**2), -w0 / p.q_mechanical, bl / m]
    rate = np.array([[0, 1, 0], force, [0, -bl / inductance, -resistance / inductance]])
    return rate, np.array([0, 0, 1 / inductance]), np.vstack([np.eye(3), rate[1]])


def exact(p, samplerate, volts, source_impedance_ohm):
    """Columns as QUANTITIES for piecewise-linear volts from 0 on, by the matrix exponential."""
    rate, coil, outputs = physics(p, source_impedance_ohm)
    system = StateSpace(rate, coil[:, None], outputs, np.zeros((4, 1)))
    return lsim(system, np.append(0.0, volts), np.arange(len(volts) + 1) / samplerate)[1][1:]


def motion_of(actuator, volts):
    motion = actuator.move(volts)
    return np.column_stack([getattr(motion, name) for name in QUANTITIES])


def errors(got, expected):
    return np.abs(got - expected).max(axis=0) / np.abs(expected).max(axis=0)


def drive(frames, samplerate):
    volts = 2.5 * np.sin(math.tau * 90.0 * (np.arange(frames) / samplerate))
    third = frames // 3
    volts[third : 2 * third] = 0.0
    volts[2 * third :] = np.random.default_rng(2).uniform(-2.5, 2.5, frames - 2 * third)
    volts[-third // 2 :] = 2.5
    return volts


# Must: 1e-4; aim: 1e-6. What remains is rounding: the poles lie about w0/samplerate from 1, so
# some 1e-16 (samplerate/w0)^2 of it come through, times Q where nothing damps it.
@pytest.mark.parametrize("source_impedance_ohm", [0.0, 8.0])
@pytest.mark.parametrize("samplerate", RATES)
@pytest.mark.parametrize("p", PARAMETERS, ids=CASES)
def test_motion_is_exact_for_a_voltage_linear_between_samples(p, samplerate, source_impedance_ohm):
    volts = drive(3_000, samplerate)
    got = motion_of(LinearActuator(p, samplerate, source_impedance_ohm), volts)
    assert errors(got, exact(p, samplerate, volts, source_impedance_ohm)).max() < 1e-8


@pytest.mark.parametrize("samplerate", RATES)
@pytest.mark.parametrize("p", PARAMETERS, ids=CASES)
def test_without_a_voltage_energy_never_grows(p, samplerate):
    actuator = LinearActuator(p, samplerate)
    actuator.move(np.append(drive(2_000, samplerate), 0.0))
    x, v, i, _ = motion_of(actuator, np.zeros(100_000)).T
    energy = p.stiffness_n_per_m * x**2 + p.moving_mass_kg * v**2 + p.inductance_h * i**2
    # Rounding of the four-term sums, relative to where the decay began.
    assert np.diff(energy).max() <= 1e-9 * energy[0]
    assert energy[-1] <= energy[0]


# Beyond 65536 frames the signal passes the fixed places where a decayed state is cleared.
@settings(max_examples=30)
@given(st.lists(st.integers(0, 70_000), max_size=12), st.sampled_from(PARAMETERS))
def test_any_split_into_blocks_gives_the_same_bytes(cuts, p):
    volts = np.zeros(70_000)
    volts[:200] = drive(200, 48_000)
    volts[69_000:] = drive(1_000, 48_000)
    volts[[100, 69_500]] = [np.nan, np.inf]
    volts[50_000] = -0.0
    whole, split = LinearActuator(p, 8_000), LinearActuator(p, 8_000)
    expected = motion_of(whole, volts)
    motions = [motion_of(split, block) for block in np.split(volts, sorted(cuts))]
    assert np.concatenate(motions).tobytes() == expected.tobytes()
    assert split.replaced_samples == whole.replaced_samples == 2


@given(st.lists(st.sampled_from(QUANTITIES), unique=True))
def test_what_is_asked_for_does_not_change_with_what_else_is(names):
    volts = drive(500, 48_000)
    full = LinearActuator(ACTUATOR, 48_000).move(volts)
    asked = LinearActuator(ACTUATOR, 48_000).move(volts, names)
    for name in QUANTITIES:
        expected = getattr(full, name) if name in names else np.empty(0)
        assert getattr(asked, name).tobytes() == expected.tobytes()


def test_after_reset_it_is_as_new_and_a_block_of_nothing_changes_nothing():
    volts, actuator = drive(500, 48_000), LinearActuator(ACTUATOR, 48_000)
    first = motion_of(actuator, np.append(volts, np.nan))[:-1]
    assert actuator.replaced_samples == 1
    actuator.reset()
    assert (actuator.replaced_samples, len(actuator.move(volts[:0]).current_a)) == (0, 0)
    assert motion_of(actuator, volts).tobytes() == first.tobytes()


def test_volts_are_not_changed_and_may_have_strides_or_be_float32():
    table = np.column_stack([drive(500, 48_000)] * 2).astype(np.float32)
    before = table.copy()
    strided = motion_of(LinearActuator(ACTUATOR, 48_000), table[:, 1])
    assert np.array_equal(table, before)
    plain = motion_of(LinearActuator(ACTUATOR, 48_000), table[:, 1].astype(np.float64))
    assert np.array_equal(strided, plain)


@given(ANY, st.sampled_from(PARAMETERS))
def test_motion_is_finite_whatever_the_volts_and_what_is_no_voltage_counts_as_zero(volts, p):
    actuator, other = LinearActuator(p, 48_000), LinearActuator(p, 48_000)
    sound = np.abs(volts) <= 1e100
    motion = motion_of(actuator, np.append(volts, np.zeros(300)))
    assert np.isfinite(motion).all()
    zeroed = motion_of(other, np.append(np.where(sound, volts, 0.0), np.zeros(300)))
    assert np.array_equal(motion, zeroed)
    assert actuator.replaced_samples == np.count_nonzero(~sound)


@pytest.mark.parametrize("changes", [{}, STIFF, OVERDAMPED], ids=["paper", "1 uH", "overdamped"])
def test_in_silence_the_actuator_comes_to_rest_before_numbers_turn_denormal(changes):
    actuator = LinearActuator(replace(ACTUATOR, **changes), 48_000)
    actuator.move(drive(4_800, 48_000))
    motion = np.abs(motion_of(actuator, np.zeros(4 * 48_000)))
    assert motion[-48_000:].max() == 0.0
    mechanical = motion[:, [0, 1, 3]]
    assert mechanical[mechanical > 0].min() > 1e-250  # denormal below 2e-308


@pytest.mark.skipif(blocks.compiled is None, reason="the compiled model alone has this setting")
def test_no_part_of_the_compiled_state_stays_denormal_while_the_rest_decays():
    # The current's own pole decays fifty times as fast as the motion: at 48 kHz it would stay at
    # the smallest number, with which each sample takes several times as long.
    actuator = LinearActuator(PAPER.actuator, 48_000.0)
    actuator.move(np.ones(480))
    for _ in range(35):
        actuator.move(np.zeros(480))
        state = np.abs(actuator._state)
        assert not np.any((state > 0.0) & (state < np.finfo(np.float64).smallest_normal))
    assert state.max() > 1e-20  # the motion still decays
    assert np.nextafter(0.0, 1.0) > 0.0  # the setting ends with the call


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_a_rate_or_a_source_impedance_that_is_none_is_refused(value):
    with pytest.raises(UsageError, match="samplerate="):
        LinearActuator(ACTUATOR, value)
    if value:
        with pytest.raises(UsageError, match="source_impedance_ohm="):
            LinearActuator(ACTUATOR, 48_000, value)
