import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from device.drive import damping as damp
from device.drive.damping import Damping, Resonance, burst_response, choose_damping, inverse_damping
from device.drive.design import damping_for, drive_design
from device.drive.exposure import ACTION_A8_M_S2, DAY_S, DoseSums
from device.drive.safety import SafetyState
from device.errors import UsageError
from device.rig import CONSUMER, PAPER, Rig
from device.rig.actuator import LinearActuator
from tests.support.random_rigs import random_rig
from tests.support.signals import tone
from tools.rig_driver import RigDriver

ACTUATOR = PAPER.actuator
STRONG = replace(ACTUATOR, force_factor_n_per_a=16.0)
CURRENT = damp.CURRENT_DRIVE_OHM
EVERY = {
    "none": Damping(),
    "inverse": inverse_damping(ACTUATOR, 0.5),
    "with gain": replace(inverse_damping(ACTUATOR, 0.7, CURRENT, caution=0.8), gain=3.0),
}


def residual(p, damping, detuning=0.0):
    """Against undamped current drive of the same rig, equally detuned."""
    plain = damp.undamped(p, detuning=detuning)
    return burst_response(p, damping, detuning=detuning).against(plain)


def worst_db(p, damping, detunings=(-0.1, 0.1)):
    return max(residual(p, damping, detuning).residual_db for detuning in detunings)


def test_undamped_current_drive_is_its_own_reference():
    shown = residual(ACTUATOR, Damping(CURRENT))
    assert (shown.residual_db, shown.peak_volts_db) == (0.0, 0.0)
    # e^(-pi f0 t / Q) = 0.1: 65 ms; the sample that is over it last lies within half a period
    expected_s = 8 * math.log(10) / (math.pi * 90)
    assert shown.settling_s == pytest.approx(expected_s, abs=0.5 / 90)


@pytest.mark.sweep
@pytest.mark.parametrize("p", [ACTUATOR, STRONG], ids=["Bl 10", "Bl 16"])
def test_the_choice_holds_the_limits_of_residual_and_volts(p):
    damping = choose_damping(p)[0].damping
    assert worst_db(p, damping, [0.0]) <= -11.0
    assert residual(p, damping).peak_volts_db <= 5.0
    assert worst_db(p, damping, (-0.1, -0.05, 0.05, 0.1)) <= -7.0


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
    assert worst_db(p, damping) <= worse_of_ten_percent_db + 0.15


def test_zeros_on_the_true_poles_do_better_at_ten_percent_than_zeros_at_f0():
    at_poles = inverse_damping(ACTUATOR, 0.7)
    ringing, wanted = Resonance(90.0, ACTUATOR.q_total()), Resonance(90.0, 0.7)
    at_f0 = replace(at_poles, ringing=ringing, wanted=wanted)
    assert worst_db(ACTUATOR, at_poles) < worst_db(ACTUATOR, at_f0) - 0.5


@pytest.mark.parametrize("source", [0.0, 8.0, CURRENT])
def test_the_resonance_is_where_the_actuator_rings(source):
    ringing = damp.resonance_of(ACTUATOR, source)
    actuator = LinearActuator(ACTUATOR, 48_000, source)
    x = actuator.move((1.0 + source) * np.eye(1, 4_800)[0]).displacement_m
    x = x[1_000:]  # the coil's own mode is gone: e^-66
    # A free vibration of two poles repeats by a recursion of two terms.
    recursion, *_ = np.linalg.lstsq(np.column_stack([x[1:-1], x[:-2]]), x[2:])
    expected = -ringing.polynomial(48_000)[1:]
    # lstsq squares nothing, but the columns are alike to 1e-2: some digits of 16 go.
    np.testing.assert_allclose(recursion, expected, rtol=1e-9)
    if source == CURRENT:  # what is left of the electrical damping: R / (R + Rs), 3e-5
        assert (ringing.frequency_hz, ringing.q) == pytest.approx((90.0, 8.0), rel=1e-4)


@pytest.mark.parametrize("samplerate", [1_000, 8_000, 48_000, 192_000])
def test_the_inverse_makes_one_resonance_another_at_any_rate(samplerate):
    ringing, wanted = Resonance(91.0, 3.0), Resonance(91.0, 0.6)
    impulse = np.eye(1, samplerate // 5)[0]
    damped = Damping(0.0, ringing, wanted).filtered(impulse, samplerate)
    # damped * (poles of the wanted one) is the zeros alone: three samples, then nothing
    rest = np.convolve(damped, wanted.polynomial(samplerate))[: len(impulse)]
    np.testing.assert_allclose(rest[:3] / rest[0], ringing.polynomial(samplerate), rtol=1e-12)
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
    step = np.ones(2_400)
    damped = EVERY["inverse"].filtered(step, 48_000)
    assert damped[0] != 0.0
    moved = [LinearActuator(ACTUATOR, 48_000).move(each).displacement_m for each in (step, damped)]
    plain, with_it = (int(np.argmax(x > 0.5 * x[-1])) for x in moved)
    # Half the way of a step: a ringing actuator gets there within 2 ms, a damped one 2 ms later.
    assert (with_it - plain) / 48_000 < 0.002


def test_of_a_resonance_known_exactly_more_is_removed_than_of_one_known_to_ten_percent():
    sure, unsure = (choose_damping(ACTUATOR, uncertainty=share)[0] for share in (0.0, 0.1))
    assert sure.as_believed.residual_db < unsure.as_believed.residual_db
    off_db = [residual(ACTUATOR, each.damping, 0.1).residual_db for each in (sure, unsure)]
    assert off_db[1] < off_db[0]


def worst_against_none(p, source, shares, by_mass):
    """The largest residual against plain drive by the same amplifier, in dB."""
    damping = choose_damping(p, source_impedance_ohm=source)[0].damping
    worst = -math.inf
    for share in shares:
        true = {"mass": 1.0 / (1.0 + share) ** 2} if by_mass else {"detuning": share}
        both = (burst_response(p, one, **true) for one in (damping, Damping(source)))
        with_it, without = (response.residual for response in both)
        worst = max(worst, 10 * math.log10(with_it / without))
    return worst


def mark(seed):
    return pytest.mark.exhaustive if seed in (*range(17), 35, 42, 50) else pytest.mark.soak


# Of 60 random rigs, 35, 42 and 50, with Qts of 8 to 10, get no filter: equal to none.
@pytest.mark.parametrize(
    ("rig", "most_db"),
    [
        pytest.param(PAPER, -0.5, id="paper"),
        pytest.param(CONSUMER, -0.5, id="consumer"),
        *(pytest.param(random_rig(n)[0], 0.0, id=f"{n}", marks=mark(n)) for n in range(60)),
    ],
)
def test_damping_is_never_worse_than_none_at_any_f0_within_a_fifth(rig, most_db):
    source, shares = rig.amplifier.source_impedance_ohm, np.linspace(-0.2, 0.2, 7)
    for by_mass in (False, True):
        assert worst_against_none(rig.actuator, source, shares, by_mass) <= most_db


def test_a_filter_that_is_sure_of_f0_would_be_worse_than_none_where_the_choice_is_not():
    rig, _ = random_rig(14)
    source = rig.amplifier.source_impedance_ohm
    sure = inverse_damping(rig.actuator, 0.35, source, caution=0.5)
    without = burst_response(rig.actuator, Damping(source), detuning=0.2).residual
    assert burst_response(rig.actuator, sure, detuning=0.2).residual > 1.2 * without
    assert worst_against_none(rig.actuator, source, (-0.2, 0.2), by_mass=False) < 0.0


def test_the_choice_uses_its_headroom_and_says_where_it_affords_nothing():
    worst = []
    for headroom_db in (0.0, 2.0, 4.0, 6.0):
        chosen = choose_damping(ACTUATOR, headroom_db=headroom_db)[0]
        assert chosen.affordable
        assert chosen.as_believed.peak_volts_db <= headroom_db
        worst.append(chosen.worst_db)
    assert worst == sorted(worst, reverse=True)
    candidates = choose_damping(ACTUATOR, headroom_db=-40.0)
    assert not candidates[0].affordable
    volts_db = [each.as_believed.peak_volts_db for each in candidates]
    assert volts_db[0] == min(volts_db)


@pytest.mark.parametrize("damping", EVERY.values(), ids=EVERY)
def test_the_core_damps_as_the_filter_does_and_protects_two_blocks_later(damping):
    # So quiet that protection does nothing.
    vibration = 1e-3 * np.random.default_rng(5).uniform(-1.0, 1.0, (6_000, 1))
    out = RigDriver(PAPER, 48_000, damping=damping).through(vibration)[:, 0]
    expected = damping.filtered(vibration[:, 0], 48_000)
    # The design is rounded: to 44 bits, which moves a pole near 1 by more.
    np.testing.assert_allclose(out, expected, atol=1e-6 * np.abs(expected).max())


def test_a_rate_too_low_for_the_resonance_is_refused_with_what_to_do():
    with pytest.raises(UsageError, match=r"choose more than 18\d Hz"):
        EVERY["inverse"].sections(150)


RATE = 48_000
SOURCE_OHM = PAPER.amplifier.source_impedance_ohm


DAMPING = damping_for(PAPER.actuator, SOURCE_OHM)
LOUD = replace(PAPER, amplifier=replace(PAPER.amplifier, gain=40.0, current_limit_a=math.inf))
DRIVEN: dict[str, tuple[Rig, dict[str, Any]]] = {
    "limited": (LOUD, {}),
    "damped": (PAPER, {"damping": DAMPING}),
    "capped": (PAPER, {"exposure_cap": "action"}),
}


def test_nothing_is_done_unless_somebody_asks_for_what_can_be():
    assert drive_design("paper", RATE) is None
    wanted: Any = {"damping": "auto", "exposure_cap": "limit"}
    asked, again = (drive_design("paper", RATE, **wanted) for _ in range(2))
    assert asked is not None
    assert asked is again
    assert (asked.damping, asked.exposure_cap) == (DAMPING, "limit")
    with pytest.raises(UsageError, match="'loud'"):
        drive_design("loud", RATE, protection="on")
    with pytest.raises(UsageError, match="samplerate=4000"):
        drive_design("paper", 4_000, protection="on")


def felt_rms(drive):
    motion = LinearActuator(PAPER.actuator, RATE, SOURCE_OHM)
    volts = drive[:, 0].astype(float) * PAPER.amplifier.gain
    return math.sqrt(np.mean(motion.move(volts).acceleration_m_s2 ** 2))


def test_damping_makes_up_for_what_it_takes_and_says_what_remains():
    # Bursts at the resonance, quiet enough for the make-up.
    burst = np.append(tone(90.0, 0.05, RATE, 0.1), np.zeros(RATE // 5))
    vibration = np.tile(burst, 4).astype(np.float32)[:, None]
    damped: Any = RigDriver(PAPER, RATE, damping=DAMPING)
    latency_frames = RigDriver(PAPER, RATE).latency_frames
    assert (damped.latency_frames, damped.strength_db) == (latency_frames, None)
    out = damped.through(vibration)
    assert 10.0 < damped.makeup_db < 20.0
    # Within a burst as strong; what rang on after it is missing: 6 dB of the energy.
    strength_db = 20 * math.log10(felt_rms(out) / felt_rms(vibration))
    assert -1.0 < strength_db < 0.5
    # Weighted by Wk at the seat, which counts the lower frequencies of a burst's edges more.
    assert damped.strength_db == pytest.approx(strength_db, abs=1.5)
    loud: Any = RigDriver(PAPER, RATE, damping=DAMPING)
    loud.through(10.0 * vibration)
    assert loud.protection().least_gain < 0.6
    assert loud.strength_db < damped.strength_db - 3.0
    plain = RigDriver(PAPER, RATE)
    plain.through(vibration)
    assert (plain.makeup_db, plain.strength_db) == (0.0, None)


@pytest.mark.parametrize("rig", [PAPER, CONSUMER])
def test_each_rig_has_its_own_damping_chosen_once(rig):
    source = rig.amplifier.source_impedance_ohm
    found: Any = damping_for(rig.actuator, source)
    # The coil's inductance raises it by a few percent.
    assert found.ringing.frequency_hz == pytest.approx(rig.actuator.resonance_hz, rel=0.1)
    assert damping_for(rig.actuator, source) is found


def test_after_reset_it_is_as_new():
    processor = RigDriver(PAPER, RATE, damping=DAMPING)
    vibration = tone(70.0, 0.3, RATE, 0.5)[:, None]
    first, readings = processor.process(vibration), processor.readings
    processor.reset()
    assert processor.process(vibration).tobytes() == first.tobytes()
    assert processor.readings == readings


@pytest.mark.parametrize("case", DRIVEN)
@settings(max_examples=10)
@given(
    cuts=st.lists(st.integers(0, 3_000), max_size=12),
    seed=st.integers(0, 2**32 - 1),
    dtype=st.sampled_from([np.float32, np.float64]),
)
def test_no_byte_and_no_reading_depends_on_how_the_stream_is_cut(case, cuts, seed, dtype):
    stream = np.random.default_rng(seed).uniform(-1.0, 1.0, (3_000, 2))
    stream[1_200:2_000] = 0.0
    stream[[50, 60]] = [[np.nan, 0.0], [np.inf, -np.inf]]
    stream = stream.astype(dtype)
    rig, options = DRIVEN[case]
    whole, split = (RigDriver(rig, 6_000, 2, **options) for _ in range(2))
    dose = DoseSums(1.0, 0.9 * ACTION_A8_M_S2**2 * DAY_S)
    for driver in (whole, split):
        driver.restore([SafetyState(20.0, 20.0, dose)] * 2)
    expected = whole.process(stream)
    blocks = [split.process(block) for block in np.split(stream, sorted(cuts))]
    assert np.concatenate(blocks).tobytes() == expected.tobytes()
    assert (split.readings, whole.protection().replaced_samples) == (whole.readings, 3)
    assert whole.protection().limited_blocks > 0
    assert (whole.exposure_gain < 1.0) == (case == "capped")
