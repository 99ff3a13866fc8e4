import math
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from device.drive.damping import inverse_damping
from device.drive.exposure import ACTION_A8_M_S2, DAY_S, DoseSums
from device.drive.protection.design import Limits, limits_of
from device.drive.safety import SafetyState
from device.errors import InternalError, UsageError
from device.rig import CONSUMER, PAPER
from device.rig.actuator import LinearActuator
from device.rig.parameters import ThermalParameters, detune
from device.rig.simulated_rig import SimulatedRig
from tests.support.possible_actuators import volts_of
from tools.rig_driver import RigDriver

DAMPING = inverse_damping(PAPER.actuator, 0.5)
LARGE: Any = PAPER.large_signal
RATE = 8_000
# An amplifier that can drive the coil through its limits: 20 V where 13 V reach Xmax. Its current
# is no limit here: that has tests of its own.
STRONG = replace(PAPER.amplifier, current_limit_a=math.inf)
LOUD = replace(PAPER, amplifier=replace(STRONG, gain=20.0))
# And one that cannot stop at ±1.5 Xmax, with a tighter limit of the level.
LOUDER = replace(PAPER, amplifier=replace(STRONG, gain=40.0, output_limit_v=30.0))
STANDARD = pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=["paper", "consumer"])
DETUNINGS = (-0.1, -0.075, -0.05, -0.025, 0.0, 0.025, 0.05, 0.075, 0.1)
TIGHT = [
    replace(rig, actuator=replace(rig.actuator, x_max_m=share * rig.actuator.x_max_m))
    for rig, share in ((CONSUMER, 0.5), (CONSUMER, 0.3), (PAPER, 0.12))
]
"""Rigs with less room to move: what their amplifiers can drive them beyond."""
DTYPES = st.sampled_from([np.float32, np.float64])


def protect(rig, drive, samplerate=RATE, **options):
    """The protector after a drive of (frames,) and enough silence, and what left it, (frames,)."""
    protector = RigDriver(rig, samplerate, 1, **options)
    silence = np.zeros(protector.latency_frames + samplerate // 10)
    out = protector.process(np.concatenate([drive, silence])[:, None])
    return protector, out[:, 0].astype(float)


def is_untouched(rig, drive, **options):
    protector, out = protect(rig, drive, **options)
    latency = protector.latency_frames
    return np.array_equal(out[latency : latency + len(drive)], drive.astype(np.float32))


def warmest_c(protector, blocks):
    warmest = []
    for block in blocks:
        protector.process(block[:, None])
        warmest.append(protector.protection().coil_c or math.nan)
    return max(warmest)


def excursions(rig, drive, samplerate=RATE):
    """The largest |x| of each detuned rig behind the amplifier, as a share of Xmax."""
    volts = volts_of(rig, drive, samplerate)
    source = rig.amplifier.source_impedance_ohm
    found = []
    for share in DETUNINGS:
        actuator = LinearActuator(detune(rig.actuator, share), samplerate, source)
        moved = actuator.move(volts, ("displacement_m",)).displacement_m
        found.append(np.abs(moved).max() / rig.actuator.x_max_m)
    return found


def tone(frequency_hz, seconds, samplerate=RATE, shape=np.sin):
    return shape(math.tau * frequency_hz * np.arange(round(seconds * samplerate)) / samplerate)


def square(phase):
    return np.sign(np.sin(phase))


@pytest.mark.parametrize("samplerate", [6_000, 8_000, 44_100, 48_000, 196_000])
def test_a_tone_at_resonance_beyond_the_excursion_comes_up_to_it_and_no_further(samplerate):
    drive = tone(90.0, 0.3, samplerate)
    assert max(excursions(LOUD, drive, samplerate)) > 1.4
    protector, out = protect(LOUD, drive, samplerate)
    largest = max(excursions(LOUD, out, samplerate))
    assert 0.85 < largest <= 1.0  # 9.1 % are held back for actuators between the models
    assert np.abs(out).max() <= 1.0
    # Each edge swings the amplifier on, and peaks lie between the places that were looked at.
    edged, _ = protect(LOUD, tone(30.0, 0.2, samplerate, shape=square), samplerate)
    assert edged.protection().limited_blocks > 50
    assert [one.protection().infeasible_blocks for one in (protector, edged)] == [0, 0]


def reached_on_the_twin(rig, out):
    """The largest |x| over Xmax of the whole twin, from the DAC on, of all detuned actuators."""
    shares = []
    for share in DETUNINGS:
        twin = SimulatedRig(replace(rig, actuator=detune(rig.actuator, share)), RATE, 1)
        twin.write(out[:, None])
        assert twin.clipped_samples == 0
        shares.append(twin.peak_displacement_m / rig.actuator.x_max_m)
    return max(shares)


@pytest.mark.sweep
@pytest.mark.parametrize("rig", TIGHT, ids=["consumer, 0.5", "consumer, 0.3", "paper, 0.12"])
@pytest.mark.parametrize("frequency_hz", [15.0, 30.0, 42.0, 45.0, 90.0])
def test_the_whole_twin_stays_within_xmax_whatever_its_amplifier_adds(rig, frequency_hz):
    for shape, frames in product((np.sin, square), (300 * RATE // 1_000, RATE // 8)):
        drive = tone(frequency_hz, 0.3, shape=shape)
        drive[frames:] = 0.0
        protector, out = protect(rig, drive)
        assert reached_on_the_twin(rig, out) <= 1.0
        assert protector.protection().infeasible_blocks == 0


@pytest.mark.parametrize("rig", [TIGHT[0], TIGHT[2]])
def test_a_protection_that_did_not_know_the_amplifiers_band_would_let_it_through(rig):
    unaware = replace(rig, amplifier=replace(rig.amplifier, low_cut_hz=0.0))
    _, out = protect(unaware, tone(15.0, 0.3, shape=square))
    assert reached_on_the_twin(rig, out) > 1.05


@pytest.mark.sweep
@pytest.mark.parametrize("frequency_hz", [2.0, 4.0, 8.0])
def test_what_an_amplifier_swings_back_long_after_a_stop_stays_within_xmax(frequency_hz):
    # So strong that what the high-pass gives back by itself would reach Xmax.
    rig = replace(PAPER, amplifier=replace(STRONG, gain=80.0, output_limit_v=1e3))
    reached = []
    for shape, until_s in product((np.sin, square), (0.06, 0.1, 0.15, 0.2)):
        drive = tone(frequency_hz, 0.4, shape=shape)
        drive[round(until_s * RATE) :] = 0.0
        protector, out = protect(rig, drive)
        reached.append(max(excursions(rig, out)))
        assert protector.protection().infeasible_blocks == 0
    # 9.1 % are held back, and 7 % for another Bl.
    assert 0.8 < max(reached) <= 1.0


@pytest.mark.sweep
@pytest.mark.parametrize("frequency_hz", [30.0, 86.0, 90.0, 140.0])
def test_a_steady_drive_keeps_as_much_as_the_fixed_gain_that_would_do(frequency_hz):
    drive = 3.0 * tone(frequency_hz, 1.0, shape=square)
    _, out = protect(LOUD, drive)
    late = slice(RATE // 2, RATE)
    fixed = min(1.0 / max(excursions(LOUD, drive)), 1.0 / 3.0)
    kept = np.sqrt(np.mean(out[late] ** 2)) / np.sqrt(np.mean((fixed * drive[late]) ** 2))
    # 0.8 dB are held back for actuators between the models, up to 1 dB for other masses and Bl,
    # 1 dB for the stop that may come next.
    assert 20 * math.log10(kept) > -2.8


def test_what_follows_a_loud_part_is_not_turned_down_for_long():
    quiet = 0.2 * tone(60.0, 4.0)
    drive = np.concatenate([tone(85.0, 0.3), quiet])
    protector, out = protect(LOUD, drive)
    end = len(drive) + protector.latency_frames
    assert np.array_equal(out[end - RATE : end], drive[-RATE:].astype(np.float32))
    assert protector.protection().least_gain < 0.7


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), DTYPES, st.sampled_from([PAPER, CONSUMER]))
def test_music_at_normal_level_leaves_bit_for_bit(seed, dtype, rig):
    rng = np.random.default_rng(seed)
    music = sum(
        rng.uniform(0, 0.2) * tone(rng.uniform(20, 220), 0.3) * (tone(rng.uniform(1, 8), 0.3) > 0)
        for _ in range(5)
    )
    music, protector = np.asarray(music, dtype)[:, None], RigDriver(rig, RATE, 1)
    assert np.array_equal(protector.through(music), music.astype(np.float32))
    assert protector.protection().limited_blocks == 0
    protector.reset()
    assert not protector.process(music)[: protector.latency_frames].any()


def test_full_scale_that_cannot_reach_the_limits_is_untouched_two_blocks_later_as_declared():
    drive = np.concatenate([tone(90.0, 0.2), tone(90.0, 0.2, shape=square), np.ones(500)])
    assert is_untouched(PAPER, drive)
    protector = RigDriver(PAPER, 48_000, 1)
    assert protector.latency_frames == 192
    assert protector.protection().latency_s == pytest.approx(0.004)


@pytest.mark.parametrize("damping", [None, DAMPING], ids=["plain", "damped"])
def test_what_is_over_full_scale_is_turned_down_without_a_corner(damping):
    protector, out = protect(PAPER, 4.0 * tone(50.0, 0.5), damping=damping)
    level = protector.limits.level
    assert 0.9 * level < np.abs(out).max() <= level * (1 + 1e-6)
    # Clipping would leave frames at the limit one beside the other.
    at_limit = np.abs(out) > 0.9999 * level
    assert not (at_limit[1:] & at_limit[:-1]).any()
    steps = np.abs(np.diff(out)).max()
    assert steps < 2.0 * 4.0 * math.tau * 50.0 / RATE  # and a click would be a step


@pytest.mark.parametrize("shape", [np.sin, square])
def test_the_current_stays_under_its_limit(shape):
    limits = Limits(excursion_m=1.5e-3, current_a=3.0)
    protector, out = protect(LOUD, tone(150.0, 0.3, shape=shape), limits=limits)
    for share in (-0.1, -0.05, 0.0, 0.05, 0.1):
        actuator = LinearActuator(detune(LOUD.actuator, share), RATE)
        current_a = np.abs(actuator.move(volts_of(LOUD, out, RATE)).current_a).max()
        assert current_a <= 3.0 * (1 + 1e-6)
        assert current_a > 2.0 or share
    assert protector.protection().infeasible_blocks == 0


@pytest.mark.exhaustive
def test_the_coil_comes_up_to_its_limit_and_stays_there():
    # 40 V into 3.3 ohm at 160 Hz, where nothing else limits much; a small coil to save time
    rig = replace(LOUDER, thermal=ThermalParameters(4.0, 0.4, 3.0, 400.0))
    protector = RigDriver(rig, 6_000, 1, limits=replace(limits_of(rig), coil_temperature_c=60.0))
    drive = 0.7 * tone(160.0, 1.0, 6_000)
    # The last block may still heat by what it was promised: some hundredths of a kelvin.
    assert warmest_c(protector, [drive] * 12) <= 60.2
    status = protector.protection()
    assert (status.coil_c or math.nan) > 58.0
    assert (status.limited_by, 0.0 < status.gain < 1.0) == ("temperature", True)


def test_a_drive_that_no_other_limit_touches_still_comes_up_to_the_temperature_only():
    rig = replace(LOUD, thermal=ThermalParameters(4.0, 0.05, 3.0, 400.0))
    drive = 0.2 * tone(20.0, 4.0, 6_000)
    warmest = {}
    for limit_c in (27.0, 120.0):
        limits = replace(limits_of(rig), coil_temperature_c=limit_c)
        warmest[limit_c] = warmest_c(RigDriver(rig, 6_000, 1, limits=limits), np.split(drive, 100))
    assert warmest[120.0] > 29.0
    assert warmest[27.0] < 27.1


def test_more_power_than_a_cool_coil_may_take_is_lowered_before_it_is_warm():
    # 0.6 W are wanted of a coil that may have 0.5 W: 0.01 J/K and 100 K over 2 s. No other limit is
    # in reach, so that blocks would leave unchanged.
    rig = replace(LOUD, thermal=ThermalParameters(1e3, 0.01, 3.0, 400.0))
    protector = RigDriver(rig, 6_000, 1, limits=limits_of(rig))
    protector.process(0.1 * tone(20.0, 0.15, 6_000)[:, None])
    status = protector.protection()
    assert status.limited_by == "temperature"
    assert (status.coil_c or math.nan) < 30.0


def test_a_burst_after_a_long_pause_heats_a_hot_coil_no_further():
    # A coil that hardly cools: after 40 s the wanted power is forgotten, but the heat is there. One
    # block of this drive heats it by 7 K; halved once, by 1.8 K, and again in each later block.
    rig = replace(LOUDER, thermal=ThermalParameters(1e6, 0.05, 3.0, 400.0))
    protector = RigDriver(rig, 6_000, 1, limits=replace(limits_of(rig), coil_temperature_c=60.0))
    drive = tone(160.0, 12.0, 6_000)
    assert warmest_c(protector, [drive]) > 59.8
    protector.process(np.zeros((240_000, 1)))
    assert 59.9 < warmest_c(protector, np.split(drive[:1_200], 100)) <= 63.0


def capped(rig, samplerate, used):
    """A protector with an exposure cap on a day of which this share of the dose is used up."""
    protector = RigDriver(rig, samplerate, 1, exposure_cap="action")
    protector.restore([SafetyState(20.0, 20.0, DoseSums(squares=used * ACTION_A8_M_S2**2 * DAY_S))])
    return protector


def test_the_gain_of_the_exposure_cap_is_kept_and_it_is_named_where_others_limit_too():
    used = 1.0 - 0.25**2 / 2.0  # of the dose: half of it is free, and the rest allows 0.25
    protector, drive = capped(PAPER, RATE, used), 0.5 * tone(50.0, 0.5)[:, None]
    out, latency = protector.process(drive), protector.latency_frames
    expected = 0.25 * drive[RATE // 4 - latency : RATE // 2 - latency, 0]
    # What is added meanwhile lowers the gain a little.
    np.testing.assert_allclose(out[RATE // 4 : RATE // 2, 0], expected, rtol=1e-3, atol=1e-7)
    assert protector.protection().limited_by == "outside"
    drive = tone(60.0, 0.5, 6_000)[:, None]
    for used, limited_by in ((0.0, "excursion, current or level"), (0.99, "outside")):
        protector = capped(LOUDER, 6_000, used)
        protector.process(drive.copy())
        assert protector.protection().limited_by == limited_by


def test_channels_are_held_by_their_own_gains():
    quiet, loud = 0.1 * tone(60.0, 0.5), tone(85.0, 0.5)
    protector = RigDriver(LOUD, RATE, 2)
    out = protector.through(np.column_stack([quiet, loud]))
    assert np.array_equal(out[:, 0], quiet.astype(np.float32))
    assert protector.protection().least_gain < 1.0


@pytest.mark.exhaustive
@settings(max_examples=100)
@given(st.lists(st.floats(), max_size=300), DTYPES, st.sampled_from([LOUD, LOUDER]), st.booleans())
@pytest.mark.filterwarnings("ignore:overflow encountered in cast")
def test_what_leaves_is_finite_and_within_full_scale_whatever_comes(samples, dtype, rig, damps):
    protector = RigDriver(rig, RATE, 1, damping=DAMPING if damps else None)
    for block in (np.array(samples).astype(dtype), np.zeros(200, dtype)):
        out = protector.process(block[:, None])
        assert (np.abs(out) <= protector.limits.level * (1 + 1e-6)).all()
    exposure = protector.exposure()
    readings = exposure.running_m_s2, exposure.a8_m_s2, exposure.vdv, exposure.extrapolated
    assert np.isfinite(readings).all()


def test_silence_comes_to_rest_and_stays_there():
    protector = RigDriver(LOUD, RATE, 1)
    protector.process(tone(85.0, 0.5)[:, None])
    for _ in range(20):
        out = protector.process(np.zeros((RATE // 4, 1)))
    assert not out.any()
    status = protector.protection()
    assert (status.excursion_m, status.gain, status.limited_by) == (0.0, 1.0, "")


def test_the_limits_are_those_that_the_rig_describes_and_what_is_out_of_range_is_refused():
    assert limits_of(LOUDER).level == 30.0 / 40.0  # where its amplifier clips
    assert limits_of(PAPER).level == 1.0
    limits, amplifier = limits_of(CONSUMER), CONSUMER.amplifier
    assert limits.excursion_m == CONSUMER.actuator.x_max_m
    assert (limits.current_a, limits.stiffness_rise) == (amplifier.current_limit_a, 0.5)
    soft = replace(PAPER, large_signal=replace(LARGE, stiffness_rise=0.1))
    assert limits_of(soft).stiffness_rise == 0.1
    assert limits_of(LOUD).current_a is None  # an amplifier without such a limit
    with pytest.raises(UsageError, match="samplerate="):
        RigDriver(PAPER, 500, 1)
    with pytest.raises(InternalError, match="shape"):
        RigDriver(PAPER, RATE, 1).process(np.zeros((10, 2)))
    with pytest.raises(UsageError, match="coil_j_per_k=0"):
        ThermalParameters(4.0, 0, 3.0, 400.0)


def test_a_rig_that_does_not_say_how_it_warms_up_has_no_temperature_and_no_limit_of_it():
    bare = replace(PAPER, thermal=None)
    protector, out = protect(bare, tone(90.0, 0.1))
    status = protector.protection()
    assert (status.coil_c, status.resistance_ohm) == (None, None)
    assert out.tobytes() == protect(PAPER, tone(90.0, 0.1))[1].tobytes()
    with pytest.raises(UsageError, match=r"describes no \[thermal\]"):
        RigDriver(bare, RATE, 1, limits=replace(limits_of(bare), coil_temperature_c=100.0))
    loud, _ = protect(replace(LOUD, thermal=None), tone(85.0, 0.3))
    assert loud.protection().least_gain < 1.0


@STANDARD
def test_a_current_that_no_drive_reaches_is_no_limit_and_another_one_is(rig):
    drive = tone(rig.actuator.resonance_hz / 2, 0.2, shape=square)
    source = rig.amplifier.source_impedance_ohm
    actuator = LinearActuator(rig.actuator, RATE, source)
    reached_a = np.abs(actuator.move(volts_of(rig, drive, RATE)).current_a).max()
    assert reached_a < limits_of(rig).current_a  # that of the amplifier
    free = replace(limits_of(rig), excursion_m=1.0)
    assert is_untouched(rig, drive, limits=free)
    _, out = protect(rig, drive, limits=replace(free, current_a=reached_a / 2))
    moved = LinearActuator(rig.actuator, RATE, source).move(volts_of(rig, out, RATE))
    assert np.abs(moved.current_a).max() <= reached_a / 2 * (1 + 1e-6)
