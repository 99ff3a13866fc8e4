"""Damping: what is left after a burst, against the limits, and how it runs live."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.drive.damping import (
    CURRENT_DRIVE_OHM,
    Damping,
    Resonance,
    burst_response,
    choose_damping,
    inverse_damping,
    resonance_of,
    undamped,
)
from device.errors import UsageError
from device.rig import CONSUMER, PAPER
from device.rig.actuator import LinearActuator
from device.rig.parameters import detune
from tests.support.random_rigs import random_rig
from tools.rig_driver import RigDriver

ACTUATOR = PAPER.actuator
STRONG = replace(ACTUATOR, force_factor_n_per_a=16.0)
CURRENT = CURRENT_DRIVE_OHM
EVERY = [
    Damping(),
    inverse_damping(ACTUATOR, 0.5),
    replace(inverse_damping(ACTUATOR, 0.7, CURRENT, caution=0.8), gain=3.0),
]
IDS = ["none", "inverse", "inverse with gain"]


def residual(p, damping, detuning=0.0):
    """Against undamped current drive of the same rig, equally detuned."""
    return burst_response(p, damping, detuning=detuning).against(undamped(p, detuning=detuning))


# ------------------------------------------------------------------------------- what is left


def test_undamped_current_drive_is_its_own_reference():
    shown = residual(ACTUATOR, Damping(CURRENT))
    assert (shown.residual_db, shown.peak_volts_db) == (0.0, 0.0)
    # e^(-pi f0 t / Q) = 0.1: 65 ms; the sample that is over it last lies within half a period
    expected_s = 8 * math.log(10) / (math.pi * 90)
    assert shown.settling_s == pytest.approx(expected_s, abs=0.5 / 90)


def test_voltage_drive_damps_as_the_ratio_of_the_qs_foretells():
    # Free decays of two resonators that were driven on resonance from rest for T: energy after is
    # (1 - e)^2 tau / 2, within T/2 - tau (1 - e) ... with e = exp(-T / tau), tau = Q / (pi f0).
    def share(q):
        tau = q / (math.pi * 90) / 0.05
        e = math.exp(-1 / tau)
        within = 1 - 2 * tau * (1 - e) + tau / 2 * (1 - e**2)
        return tau / 2 * (1 - e) ** 2 / within

    expected_db = 10 * math.log10(share(ACTUATOR.q_total()) / share(8.0))
    # The coil's inductance and the start of the sine are left out of it.
    assert residual(ACTUATOR, Damping()).residual_db == pytest.approx(expected_db, abs=0.5)


@pytest.mark.sweep
@pytest.mark.parametrize("p", [ACTUATOR, STRONG], ids=["Bl 10", "Bl 16"])
def test_the_choice_holds_the_limits_of_residual_and_volts(p):
    damping = choose_damping(p)[0].damping
    believed = residual(p, damping)
    assert believed.residual_db <= -11.0
    assert believed.peak_volts_db <= 5.0
    for detuning in (-0.1, -0.05, 0.05, 0.1):
        assert residual(p, damping, detuning).residual_db <= -7.0


# The figures of a prototype: what is built must not do worse. 0.15 dB: of its solver's step.
@pytest.mark.parametrize(
    ("p", "damping", "exact_db", "worse_of_ten_percent_db"),
    [
        (ACTUATOR, inverse_damping(ACTUATOR, 0.7, CURRENT), -13.1, -0.5),
        (ACTUATOR, Damping(), -5.4, -4.4),
        (ACTUATOR, inverse_damping(ACTUATOR, 0.7), -11.6, -7.9),
        (STRONG, inverse_damping(STRONG, 0.5), -12.8, -11.0),
    ],
)
def test_each_way_does_what_the_prototype_did(p, damping, exact_db, worse_of_ten_percent_db):
    assert residual(p, damping).residual_db <= exact_db + 0.15
    worse = max(residual(p, damping, detuning).residual_db for detuning in (-0.1, 0.1))
    assert worse <= worse_of_ten_percent_db + 0.15


def test_zeros_on_the_true_poles_do_better_at_ten_percent_than_zeros_at_f0():
    at_poles = inverse_damping(ACTUATOR, 0.7)
    at_f0 = replace(
        at_poles, ringing=Resonance(90.0, ACTUATOR.q_total()), wanted=Resonance(90.0, 0.7)
    )
    worst = [
        max(residual(ACTUATOR, d, off).residual_db for off in (-0.1, 0.1))
        for d in (at_poles, at_f0)
    ]
    assert worst[0] < worst[1] - 0.5


# ------------------------------------------------------------------------------------ designs


@pytest.mark.parametrize("source", [0.0, 8.0, CURRENT])
def test_the_resonance_is_where_the_actuator_rings(source):
    ringing = resonance_of(ACTUATOR, source)
    actuator = LinearActuator(ACTUATOR, 48_000, source)
    impulse = np.zeros(4_800)
    impulse[0] = 1.0 + source
    x = actuator.move(impulse).displacement_m[1_000:]  # the coil's own mode is gone: e^-66
    # A free vibration of two poles repeats by a recursion of two terms.
    recursion, *_ = np.linalg.lstsq(np.column_stack([x[1:-1], x[:-2]]), x[2:])
    expected = -ringing.polynomial(48_000)[1:]
    # lstsq squares nothing, but the columns are alike to 1e-2: some digits of 16 go.
    np.testing.assert_allclose(recursion, expected, rtol=1e-9)


def test_driven_by_current_it_rings_at_f0_with_the_mechanical_q():
    ringing = resonance_of(ACTUATOR, CURRENT)
    # What is left of the electrical damping: R / (R + Rs), 3e-5.
    assert ringing.frequency_hz == pytest.approx(90.0, rel=1e-4)
    assert ringing.q == pytest.approx(8.0, rel=1e-4)


@pytest.mark.parametrize("samplerate", [1_000, 8_000, 48_000, 192_000])
def test_the_inverse_makes_one_resonance_another_at_any_rate(samplerate):
    ringing, wanted = Resonance(91.0, 3.0), Resonance(91.0, 0.6)
    damping = Damping(0.0, ringing, wanted)
    frames = samplerate // 5
    impulse = np.zeros(frames)
    impulse[0] = 1.0
    damped = damping.filtered(impulse, samplerate)
    # damped * (poles of the wanted one) is the zeros alone: three samples, then nothing
    rest = np.convolve(damped, wanted.polynomial(samplerate))[:frames]
    zeros = ringing.polynomial(samplerate)
    np.testing.assert_allclose(rest[:3] / rest[0], zeros, rtol=1e-12)
    assert np.abs(rest[3:]).max() < 1e-12


@given(st.floats(10.0, 400.0), st.floats(0.6, 50.0), st.floats(0.3, 1.0))
def test_the_inverse_needs_no_more_level_for_any_steady_tone(frequency_hz, q, share):
    wanted = Resonance(frequency_hz, max(0.3, share * q))
    b0, b1, b2, _, a1, a2 = Damping(0.0, Resonance(frequency_hz, q), wanted).sections(48_000)[0]
    z = np.exp(-1j * math.tau * np.geomspace(1.0, 24_000.0, 500) / 48_000)
    gain = np.abs((b0 + b1 * z + b2 * z**2) / (1 + a1 * z + a2 * z**2))
    # The sampled pair's peak is flatter than the analogue one's by (w0 T)^2.
    assert gain.max() <= 1.0 + 5e-3


def test_damping_makes_nothing_later():
    damping = inverse_damping(ACTUATOR, 0.5)
    impulse = np.zeros(10)
    impulse[0] = 1.0
    assert damping.filtered(impulse, 48_000)[0] != 0.0
    step = np.ones(2_400)
    rise = [
        np.argmax(x > 0.5 * x[-1])
        for x in (
            LinearActuator(ACTUATOR, 48_000).move(np.ones(2_400)).displacement_m,
            LinearActuator(ACTUATOR, 48_000).move(damping.filtered(step, 48_000)).displacement_m,
        )
    ]
    # Half the way of a step: a ringing actuator gets there within 2 ms, a damped one 2 ms later.
    assert (rise[1] - rise[0]) / 48_000 < 0.002


# ------------------------------------------------------------------------------------- choice


def test_of_a_resonance_known_exactly_more_is_removed_than_of_one_known_to_ten_percent():
    sure = choose_damping(ACTUATOR, uncertainty=0.0)[0]
    unsure = choose_damping(ACTUATOR, uncertainty=0.1)[0]
    assert sure.as_believed.residual_db < unsure.as_believed.residual_db
    assert residual(ACTUATOR, unsure.damping, 0.1).residual_db < (
        residual(ACTUATOR, sure.damping, 0.1).residual_db
    )


def worst_against_none(p, source, shares, by_mass):
    """The largest residual against plain drive by the same amplifier, in dB."""
    damping = choose_damping(p, source_impedance_ohm=source)[0].damping
    worst = -math.inf
    for share in shares:
        true = {"mass": 1.0 / (1.0 + share) ** 2} if by_mass else {"detuning": share}
        with_it, without = (
            burst_response(p, one, **true).residual for one in (damping, Damping(source))
        )
        worst = max(worst, 10 * math.log10(with_it / without))
    return worst


@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=["paper", "consumer"])
@pytest.mark.parametrize("by_mass", [False, True], ids=["by stiffness", "by mass"])
def test_damping_is_never_worse_than_none_at_any_f0_within_a_fifth(rig, by_mass):
    source = rig.amplifier.source_impedance_ohm
    shares = (-0.2, -0.13, -0.07, 0.0, 0.07, 0.13, 0.2)
    assert worst_against_none(rig.actuator, source, shares, by_mass) < -0.5


def test_a_filter_that_is_sure_of_f0_would_be_worse_than_none_where_the_choice_is_not():
    rig, _ = random_rig(14)
    source = rig.amplifier.source_impedance_ohm
    sure = inverse_damping(rig.actuator, 0.35, source, caution=0.5)
    without = burst_response(rig.actuator, Damping(source), detuning=0.2).residual
    assert burst_response(rig.actuator, sure, detuning=0.2).residual > 1.2 * without
    assert worst_against_none(rig.actuator, source, (-0.2, 0.2), by_mass=False) < 0.0


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", range(60))
def test_damping_is_never_worse_than_none_on_random_rigs(seed):
    rig, _ = random_rig(seed)
    shares = [-0.2, 0.2, *np.random.default_rng(seed).uniform(-0.2, 0.2, 10)]
    source = rig.amplifier.source_impedance_ohm
    for by_mass in (False, True):
        # Three of 60 rigs, with Qts of 8 to 10, get no filter: equal to none.
        assert worst_against_none(rig.actuator, source, shares, by_mass) <= 0.0


@pytest.mark.exhaustive
def test_the_choice_stays_within_its_headroom_and_uses_it():
    worst = []
    for headroom_db in (0.0, 2.0, 4.0, 6.0):
        chosen = choose_damping(ACTUATOR, headroom_db=headroom_db)[0]
        assert chosen.affordable
        assert chosen.as_believed.peak_volts_db <= headroom_db
        worst.append(chosen.worst_db)
    assert worst == sorted(worst, reverse=True)


def test_where_nothing_is_affordable_the_fewest_volts_are_chosen_and_it_says_so():
    candidates = choose_damping(ACTUATOR, headroom_db=-40.0)
    assert not candidates[0].affordable
    volts_db = [c.as_believed.peak_volts_db for c in candidates]
    assert volts_db[0] == min(volts_db)


def test_the_makeup_gives_a_burst_as_strong_as_without_damping():
    chosen = choose_damping(ACTUATOR)[0]
    damping = replace(chosen.damping, gain=chosen.makeup)
    made_up = burst_response(ACTUATOR, damping).rms_m_s2
    assert made_up == pytest.approx(burst_response(ACTUATOR, Damping()).rms_m_s2, rel=1e-9)


def test_a_detuned_rig_has_the_same_mass_and_friction():
    rig = detune(ACTUATOR, -0.1)
    assert rig.resonance_hz == pytest.approx(81.0)
    assert rig.moving_mass_kg == ACTUATOR.moving_mass_kg
    assert rig.damping_n_s_per_m == pytest.approx(ACTUATOR.damping_n_s_per_m, rel=1e-12)


# --------------------------------------------------------------------------------------- live


QUIET = 1e-3
"""A level at which protection does nothing."""


def noise(frames, channels=2):
    return QUIET * np.random.default_rng(5).uniform(-1.0, 1.0, (frames, channels))


@pytest.mark.parametrize("damping", EVERY, ids=IDS)
def test_the_core_damps_as_the_filter_does_and_protects_two_blocks_later(damping):
    vibration = noise(6_000, 1)
    out = RigDriver(PAPER, 48_000, damping=damping).through(vibration)[:, 0]
    expected = damping.filtered(vibration[:, 0], 48_000)
    # The design is rounded: to 44 bits, which moves a pole near 1 by more.
    np.testing.assert_allclose(out, expected, atol=1e-6 * np.abs(expected).max())


# ---------------------------------------------------------------------------------- bad input


def test_a_rate_too_low_for_the_resonance_is_refused_with_what_to_do():
    with pytest.raises(UsageError, match=r"choose more than 18\d Hz"):
        EVERY[1].sections(150)
