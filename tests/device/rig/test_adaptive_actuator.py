"""The levels against reference solutions, and the adaptive that chooses among them."""

import math
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import butter, sosfilt

from device.errors import UsageError
from device.rig import PAPER
from device.rig.actuator import QUANTITIES, LinearActuator
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.co_energy import energies, linear_energies
from device.rig.crossfade import crossfade
from device.rig.model_levels import ModelLevel
from device.rig.thermal import COPPER_PER_K, Temperatures
from tests.support.co_energy import flux_linkage_wb, stored_energy_j

EXHAUSTIVE = pytest.mark.exhaustive

FS = 48_000
TONES_HZ = (20.0, 46.6, 92.0, 128.2, 140.9, 182.0, 220.0)
SEAT = "seat_acceleration_m_s2"
FLOOR = 0.01
assert PAPER.seat
assert PAPER.large_signal
assert PAPER.thermal
SITTER, LARGE, THERMAL = PAPER.seat, PAPER.large_signal, PAPER.thermal


def tones(level_v, times):
    return level_v * sum(np.sin(math.tau * hz * times) for hz in TONES_HZ)


def times_of(samplerate, duration_s):
    return np.arange(round(samplerate * duration_s)) / samplerate


@cache
def reference(level_v, samplerate, seat=False, duration_s=0.04):
    """Columns as QUANTITIES and the seat's acceleration: solve_ivp at 1e-12, true sinusoids.

    Written from the energies and the equations of motion in plain states, apart from the levels.
    """
    p, e = PAPER.actuator, energies(PAPER.actuator, LARGE)
    m, c = p.moving_mass_kg, p.damping_n_s_per_m

    def rates(t, s):
        y, u, i, z, zs = s
        x, current = np.array([y]), np.array([i])
        w = u - (zs if seat else 0.0)
        at = e.co_energy.at(x, flux_linkage_wb(e.co_energy, x, current))
        force = at.force_n[0] - e.potential.jet(x)[1][0] - c * w
        change = p.resistance_ohm * i + at.flux_slope[0] * w
        rate = (tones(level_v, t) - change) / at.inductance_h[0]
        frame = 0.0
        if seat:
            frame = -(force + SITTER.stiffness_n_per_m * z + SITTER.damping_n_s_per_m * zs)
            frame /= SITTER.mass_kg
        return [w, force / m, rate, zs if seat else 0.0, frame]

    times = times_of(samplerate, duration_s)
    solved = solve_ivp(rates, (0, times[-1]), np.zeros(5), "DOP853", times, rtol=1e-12, atol=1e-14)
    derived = np.array([rates(t, s) for t, s in zip(times, solved.y.T, strict=True)]).T
    y, _, i, _, _ = solved.y
    return np.array([y, derived[0], i, derived[1], derived[4]])


def columns(motion, names=QUANTITIES):
    return np.array([getattr(motion, name) for name in names])


def errors(got, expected):
    """Largest error of each row over its largest value."""
    return np.abs(got - expected).max(axis=1) / np.abs(expected).max(axis=1)


# ------------------------------------------------------------------------------------ accuracy


# 192 kHz: straight lines lose (pi f / fs)^2 / 3, 4e-6 at 220 Hz. Then there are the fourth order
# of the nodes (1e-6) and, for current and acceleration, parabolas between them (3e-5 at 6 kHz).
@pytest.mark.parametrize("level_v", [7.0, pytest.param(2.0, marks=EXHAUSTIVE)])
def test_the_non_linear_model_solves_the_equations(level_v):
    expected = reference(level_v, 192_000)[:4]
    volts = tones(level_v, times_of(192_000, 0.04))
    got = columns(AdaptiveActuator(PAPER, 192_000, level=ModelLevel.NONLINEAR).move(volts))
    displacement, velocity, current, acceleration = errors(got, expected)
    assert displacement < 1e-5
    assert velocity < 2e-5
    assert current < 1e-4
    assert acceleration < 1e-4
    # It is worth it: the linear level is far off at these levels.
    linear = columns(AdaptiveActuator(PAPER, 192_000, level=ModelLevel.LINEAR).move(volts))
    assert errors(linear, expected)[0] > 0.02


@pytest.mark.exhaustive
def test_at_48_khz_the_non_linear_model_keeps_a_ten_thousandth_below_the_stops():
    volts = tones(7.0, times_of(FS, 0.04))
    got = columns(AdaptiveActuator(PAPER, FS, level=ModelLevel.NONLINEAR).move(volts))
    expected = reference(7.0, FS)[:4]
    assert 0.5 * PAPER.actuator.x_max_m < np.abs(expected[0]).max()
    assert np.abs(expected[0]).max() < LARGE.stop_m
    # Straight lines between samples: 7e-5 at 220 Hz, less where the motion is slower.
    assert errors(got, expected).max() < 1e-4


@pytest.mark.exhaustive
def test_on_the_seat_the_models_solve_the_equations_of_both_masses():
    expected = reference(5.0, 192_000, seat=True)
    volts = tones(5.0, times_of(192_000, 0.04))
    adaptive = AdaptiveActuator(PAPER, 192_000, level=ModelLevel.NONLINEAR, seat=True)
    got = columns(adaptive.move(volts, (*QUANTITIES, SEAT)), (*QUANTITIES, SEAT))
    assert errors(got, expected).max() < 1e-4
    stepped = AdaptiveActuator(PAPER, 192_000, level=ModelLevel.STEPPED, seat=True)
    got = columns(stepped.move(volts, (*QUANTITIES, SEAT)), (*QUANTITIES, SEAT))
    # Second order: (w / fs)^2 / 12 and its like, grown by a resonance.
    assert errors(got, expected).max() < 1e-3


def test_the_step_by_step_model_solves_the_same_equations():
    expected = reference(7.0, 192_000)[:4]
    volts = tones(7.0, times_of(192_000, 0.04))
    got = columns(AdaptiveActuator(PAPER, 192_000, level=ModelLevel.STEPPED).move(volts))
    assert errors(got, expected).max() < 1e-3


def test_the_linear_model_of_a_rig_without_large_signal_is_the_whole_truth():
    rig = replace(PAPER, large_signal=None)
    volts = tones(7.0, times_of(FS, 0.1))
    exact = columns(LinearActuator(PAPER.actuator, FS).move(volts))
    for level in (ModelLevel.LINEAR, ModelLevel.NONLINEAR):
        got = columns(AdaptiveActuator(rig, FS, level=level).move(volts))
        assert errors(got, exact).max() < 1e-12
    adaptive = AdaptiveActuator(rig, FS, 1e-9)
    assert np.array_equal(columns(adaptive.move(volts)), exact)
    assert adaptive.frames_by_level[ModelLevel.LINEAR] > 4_000


@pytest.mark.parametrize(
    "frequency_hz",
    [
        1_000.0,
        12_090.0,
        pytest.param(5_000.0, marks=EXHAUSTIVE),
        pytest.param(11_910.0, marks=EXHAUSTIVE),
    ],
)
def test_content_above_the_nodes_does_not_come_back_as_vibration(frequency_hz):
    times = times_of(FS, 0.15)
    volts = 6.0 * np.sin(math.tau * 90.0 * times)
    volts += 6.0 * np.sin(math.tau * frequency_hz * times)
    true = AdaptiveActuator(PAPER, FS, level=ModelLevel.NONLINEAR, step_tolerance=1e-6).move(volts)
    got = AdaptiveActuator(PAPER, FS, level=ModelLevel.NONLINEAR).move(volts)
    error = np.abs(got.displacement_m - true.displacement_m).max()
    assert error < 1e-4 * np.abs(true.displacement_m).max()


# -------------------------------------------------------------------------------------- energy


def band_noise(level_v, samplerate, duration_s, seed):
    noise = np.random.default_rng(seed).standard_normal(round(samplerate * duration_s))
    band = sosfilt(butter(4, [20, 220], "band", fs=samplerate, output="sos"), noise)
    return level_v * band / np.abs(band).max()


def surplus_of(volts, motion_of, e, fine):
    """(energy in that was neither stored nor turned into heat, energy in either way), J.

    The straight lines of the voltage at 48 kHz get `fine` points each, where the motion is known
    too; Simpson's rule then has no corner inside.
    """
    p = PAPER.actuator
    frames = len(volts)
    lines = np.interp(np.arange(frames * fine) / fine, np.arange(frames), volts)
    motion = motion_of(FS * fine).move(lines)
    heat_w = p.resistance_ohm * motion.current_a**2
    heat_w += p.damping_n_s_per_m * motion.velocity_m_s**2
    pressed = np.abs(e.stops.jet(motion.displacement_m)[1])
    heat_w += e.stop_loss_s_per_m * pressed * motion.velocity_m_s**2
    power_w = lines * motion.current_a - heat_w
    stored_j = stored_energy_j(e, motion.displacement_m, motion.current_a)
    stored_j += p.moving_mass_kg * motion.velocity_m_s**2 / 2
    last = (frames - 2) * fine
    simpson_w = power_w[:last:2] + 4 * power_w[1:last:2] + power_w[2 : last + 1 : 2]
    energy_error_j = simpson_w.sum() / (3 * FS * fine) - (stored_j[last] - stored_j[0])
    return energy_error_j, np.abs(lines * motion.current_a).sum() / (FS * fine)


# The last of the levels goes into the stops.
@pytest.mark.parametrize("level_v", [5.0, 20.0, 60.0])
@pytest.mark.parametrize(
    "seed", [1, pytest.param(2, marks=EXHAUSTIVE), pytest.param(3, marks=EXHAUSTIVE)]
)
def test_the_non_linear_model_is_passive_on_random_drives(level_v, seed):
    energy_error_j, through_j = surplus_of(
        band_noise(level_v, FS, 0.25, seed),
        lambda samplerate: AdaptiveActuator(PAPER, samplerate, level=ModelLevel.NONLINEAR),
        energies(PAPER.actuator, LARGE),
        4,
    )
    assert abs(energy_error_j) <= 1e-6 * through_j


def test_the_linear_model_is_passive_on_random_drives():
    volts = np.random.default_rng(6).standard_normal(1_000)
    energy_error_j, through_j = surplus_of(
        volts,
        lambda samplerate: LinearActuator(PAPER.actuator, samplerate),
        linear_energies(PAPER.actuator),
        32,
    )
    assert abs(energy_error_j) <= 1e-6 * through_j


# ------------------------------------------------------------------------------------ hard cases

HARD = {
    "Q 1000": {"q_mechanical": 1_000.0, "force_factor_n_per_a": 0.5},
    "1 uH": {"inductance_h": 1e-6},
    "Q 1000 and 1 uH": {
        "q_mechanical": 1_000.0,
        "force_factor_n_per_a": 0.5,
        "inductance_h": 1e-6,
    },
    "overdamped": {"force_factor_n_per_a": 60.0, "inductance_h": 1e-4},
    "hard stops": {},
}


def hard_rig(case):
    large = replace(LARGE, stop_n_per_m2=1e12 if case == "hard stops" else 1.3e9)
    return replace(PAPER, actuator=replace(PAPER.actuator, **HARD[case]), large_signal=large)


def hard_drive(frames):
    """Steps of full scale either way, noise, and two samples that are no numbers."""
    volts = np.full(frames, 60.0)
    volts[frames // 4 :] = -60.0
    volts[frames // 2 :] = 40.0 * np.random.default_rng(7).standard_normal(frames - frames // 2)
    volts[frames // 3], volts[frames // 3 + 1] = math.nan, -math.inf
    return volts


@pytest.mark.sweep
@pytest.mark.parametrize(
    "samplerate",
    [
        8_000,
        pytest.param(1_000, marks=EXHAUSTIVE),
        pytest.param(3_000, marks=EXHAUSTIVE),
        pytest.param(44_100, marks=EXHAUSTIVE),
        pytest.param(192_000, marks=EXHAUSTIVE),
    ],
)
@pytest.mark.parametrize("case", HARD)
@pytest.mark.parametrize("level", [None, ModelLevel.NONLINEAR])
def test_full_scale_steps_noise_and_nan_never_give_anything_but_finite_motion(
    case, samplerate, level
):
    adaptive = AdaptiveActuator(hard_rig(case), samplerate, level=level)
    motion = columns(adaptive.move(hard_drive(samplerate // 10)))
    assert np.isfinite(motion).all()
    assert adaptive.replaced_samples == 2
    # Finite means bounded as well: even these stops give way by less than their own distance.
    assert np.abs(motion[0]).max() < 3 * LARGE.stop_m


@pytest.mark.sweep
@pytest.mark.parametrize(
    "samplerate",
    [1_000, pytest.param(48_000, marks=EXHAUSTIVE), pytest.param(192_000, marks=EXHAUSTIVE)],
)
@pytest.mark.parametrize("case", HARD)
@pytest.mark.parametrize("level", [ModelLevel.LINEAR, ModelLevel.STEPPED])
def test_every_other_model_asked_for_stays_finite_there_too(case, samplerate, level):
    adaptive = AdaptiveActuator(hard_rig(case), samplerate, level=level, seat=True)
    frames = 48 * samplerate // 1_000
    assert np.isfinite(columns(adaptive.move(hard_drive(frames), (*QUANTITIES, SEAT)))).all()
    assert adaptive.replaced_samples == 2
    assert np.isfinite(columns(adaptive.move(np.zeros(frames), (*QUANTITIES, SEAT)))).all()


@pytest.mark.exhaustive
def test_the_end_stops_are_reached_and_hold_at_every_rate():
    reached = []
    for samplerate in (1_000, 6_000, 48_000, 192_000):
        volts = 60.0 * np.sin(math.tau * 80.0 * times_of(samplerate, 0.1))
        adaptive = AdaptiveActuator(PAPER, samplerate, level=ModelLevel.NONLINEAR)
        reached.append(np.abs(adaptive.move(volts).displacement_m).max())
    assert min(reached) > LARGE.stop_m
    # Straight lines between samples at 1 kHz miss (2 pi 80 / 1000)^2 / 12 of the drive, 2 %.
    assert np.ptp(reached) < 0.03 * max(reached)


@settings(max_examples=15, deadline=None)
@given(
    st.lists(
        st.floats(-200, 200) | st.sampled_from([math.nan, math.inf, 1e300]), min_size=1, max_size=60
    ),
    st.floats(1_000, 192_000),
    st.sampled_from(sorted(HARD)),
)
def test_whatever_comes_in_the_adaptive_actuator_gives_finite_motion(volts, samplerate, case):
    motion = columns(AdaptiveActuator(hard_rig(case), samplerate).move(np.array(volts)))
    assert motion.shape == (4, len(volts))
    assert np.isfinite(motion).all()


def test_what_does_not_converge_is_stepped_counted_and_called_unmeasured():
    # A force that takes a millionth of a micrometre to stop the mass: no step is short enough.
    rig = replace(PAPER, large_signal=replace(LARGE, stop_n_per_m2=1e18))
    adaptive = AdaptiveActuator(rig, 1_000, level=ModelLevel.NONLINEAR)
    adaptive.move(200.0 * np.random.default_rng(8).standard_normal(300))
    assert adaptive.stepped_frames > 0
    assert math.isinf(max(block.estimate for block in adaptive.reports))
    assert np.isfinite(columns(adaptive.move(np.zeros(10)))).all()


def test_left_alone_the_motion_dies_away_over_a_million_samples():
    adaptive = AdaptiveActuator(hard_rig("Q 1000"), FS)
    adaptive.move(tones(1.0, times_of(FS, 0.5)))
    peaks = [np.abs(adaptive.move(np.zeros(FS)).displacement_m).max() for _ in range(20)]
    assert all(after < before for before, after in pairwise(peaks))
    # Q 1000 at 90 Hz: amplitude falls by exp(-pi 90 / 1000) a second, a little more by Bl.
    assert peaks[-1] < peaks[0] * math.exp(-0.27 * 18)


# ---------------------------------------------------------------------------------------- adaptive


def swell(duration_s=1.6):
    """Tones from a whisper to beyond Xmax and back."""
    times = times_of(FS, duration_s)
    shares = np.array([0, 0.3, 0.6, 0.75, 1]) * duration_s
    return np.interp(times, shares, [0.02, 0.4, 8.0, 0.05, 0.0]) * tones(1.0, times)


@cache
def true_swell():
    return AdaptiveActuator(PAPER, FS, level=ModelLevel.NONLINEAR, step_tolerance=1e-6).move(
        swell()
    )


def shares_of_tolerance(adaptive, motion, true, tolerance):
    """Each block's true error over what was allowed there, as the adaptive measures it."""
    p, shares = PAPER.actuator, []
    floors = {"displacement_m": FLOOR * p.x_max_m}
    floors["acceleration_m_s2"] = floors["displacement_m"] * p.resonance_rad_s**2
    for block in adaptive.reports:
        part = slice(block.frame, block.frame + block.frames)
        for name, floor in floors.items():
            got, expected = getattr(motion, name)[part], getattr(true, name)[part]
            peak = max(np.abs(expected).max(), floor)
            shares.append(np.abs(got - expected).max() / peak / tolerance)
    return np.array(shares)


@pytest.mark.parametrize(
    "tolerance",
    [
        1e-2,
        1e-3,
        pytest.param(1e-1, marks=EXHAUSTIVE),
        pytest.param(3e-2, marks=EXHAUSTIVE),
        pytest.param(1e-4, marks=EXHAUSTIVE),
    ],
)
def test_no_block_is_further_off_than_the_tolerance(tolerance):
    adaptive = AdaptiveActuator(PAPER, FS, tolerance)
    motion = adaptive.move(swell())
    shares = shares_of_tolerance(adaptive, motion, true_swell(), tolerance)
    assert len(shares) == 2 * len(adaptive.reports) >= 30
    assert shares.max() <= 1.0


@pytest.mark.parametrize("tolerance", [3e-3, pytest.param(1e-1, marks=EXHAUSTIVE)])
def test_loud_and_quiet_bursts_in_turn_keep_the_tolerance_too(tolerance):
    # A quiet block after a loud one has the smaller peak, and what the loud one left behind.
    random = np.random.default_rng(11)
    times = times_of(FS, 0.25)
    edge = np.minimum(1.0, np.minimum(times, times[::-1]) / 0.005)
    parts = [
        40.0 * 10.0 ** random.uniform(-3.0, 0.0) * edge
        * np.sin(math.tau * 20.0 * 11.0 ** random.random() * times)
        for _ in range(16)
    ]  # fmt: skip
    volts = np.concatenate(parts)
    true = AdaptiveActuator(PAPER, FS, level=ModelLevel.NONLINEAR, step_tolerance=1e-6).move(volts)
    adaptive = AdaptiveActuator(PAPER, FS, tolerance)
    shares = shares_of_tolerance(adaptive, adaptive.move(volts), true, tolerance)
    assert shares.max() <= 1.0


def test_the_adaptive_actuator_uses_the_dearer_model_only_where_it_has_to():
    loose, tight = AdaptiveActuator(PAPER, FS, 3e-2), AdaptiveActuator(PAPER, FS, 1e-3)
    for adaptive in (loose, tight):
        adaptive.move(swell())
    used = loose.frames_by_level
    assert min(used[ModelLevel.LINEAR], used[ModelLevel.NONLINEAR]) > 0
    assert tight.frames_by_level[ModelLevel.NONLINEAR] > used[ModelLevel.NONLINEAR]
    assert sum(used.values()) == sum(report.frames for report in loose.reports)
    for report in loose.reports:
        assert report.estimate <= 3e-2
        assert report.level is not ModelLevel.LINEAR or report.excursion_peak_m < 0.6e-3


def test_quiet_blocks_after_loud_ones_go_back_to_the_linear_model():
    times = times_of(FS, 3.0)
    volts = np.where(times < 1.5, 12.0, 0.05) * np.sin(math.tau * 70.0 * times)
    adaptive = AdaptiveActuator(PAPER, FS, 1e-2)
    adaptive.move(volts)
    assert {block.level for block in adaptive.reports if block.frame < FS} == {ModelLevel.NONLINEAR}
    assert {block.level for block in adaptive.reports if block.frame > 2 * FS} == {
        ModelLevel.LINEAR
    }


def test_what_a_loud_part_left_behind_is_dropped_while_quiet_sound_goes_on():
    times = times_of(FS, 2.0)
    volts = np.where(times < 0.5, 12.0, 0.05) * np.sin(math.tau * 70.0 * times)
    got = AdaptiveActuator(PAPER, FS, 1e-2).move(volts).acceleration_m_s2
    alone = LinearActuator(PAPER.actuator, FS).move(volts).acceleration_m_s2
    later = slice(round(0.85 * FS), None)
    assert np.array_equal(got[later], alone[later])
    # What is dropped shows nowhere: by then it is a hundredth of the tolerance at 1 % of Xmax.
    least = FLOOR * PAPER.actuator.x_max_m * PAPER.actuator.resonance_rad_s**2
    true = AdaptiveActuator(PAPER, FS, level=ModelLevel.NONLINEAR, step_tolerance=1e-6).move(volts)
    last = slice(round(0.7 * FS), None)
    assert np.abs(got - true.acceleration_m_s2)[last].max() <= 1e-2 * max(
        least, np.abs(true.acceleration_m_s2[last]).max()
    )


# At 5e-2 the linear model is off by almost all that is allowed before the change.
@pytest.mark.parametrize(
    "tolerance",
    [
        2e-2,
        pytest.param(5e-2, marks=EXHAUSTIVE),
        pytest.param(3e-2, marks=EXHAUSTIVE),
        pytest.param(1e-2, marks=EXHAUSTIVE),
    ],
)
def test_a_switch_of_models_makes_no_click(tolerance):
    adaptive = AdaptiveActuator(PAPER, FS, tolerance)
    times = times_of(FS, 1.6)
    envelope = 0.4 + 3.0 * np.sin(math.pi * times / 1.6) ** 2
    volts = envelope * (np.sin(math.tau * 46.6 * times) + np.sin(math.tau * 92.0 * times))
    motion = adaptive.move(volts).acceleration_m_s2
    assert len({report.level for report in adaptive.reports}) >= 2
    # Above 800 Hz these two tones have next to nothing, distorted or not: -104 dB.
    high = sosfilt(butter(8, 800, "high", fs=FS, output="sos"), motion)
    level_db = 20 * math.log10(np.abs(high[2_000:-2_000]).max() / np.abs(motion).max())
    assert level_db < -95


def test_without_the_fade_the_same_switch_would_click(monkeypatch):
    monkeypatch.setattr("device.rig.adaptive_actuator.FADE_S", 1e-4)
    with pytest.raises(AssertionError):
        test_a_switch_of_models_makes_no_click(2e-2)


def test_a_fade_leaves_the_old_path_as_smoothly_as_it_arrives_at_the_new_one():
    time = np.arange(1, 481) / 480
    old, new = 3.0 + np.sin(9.0 * time), 0.2 * np.cos(4.0 * time)
    values = np.concatenate([new, np.full(100, new[-1])])
    crossfade(values[None], old[None], 2.0)
    for order in range(3):
        # As a share of the old path's own differences; the weight's own begin with t^3, of which
        # three samples have seen some per cent. A cosine's curvature would be 36 %, a kink more.
        begin, path = np.diff(values, order)[:3], np.diff(old, order)[:3]
        assert np.abs(begin - path).max() <= 0.1 * np.abs(np.diff(old, order)).max()
    assert np.array_equal(values[480:], np.full(100, new[-1]))


@given(st.floats(-1.0, 1.0), st.floats(0.0, 5.0))
def test_a_fade_is_no_further_off_than_allowed_or_than_the_jump_itself(jump, wrong):
    old = jump + wrong * np.arange(480) / 100.0
    values = np.ones(480)
    crossfade(values[None], 1.0 + old[None], 0.1)
    # Cut to 8 samples at least: there the old path has gone on to be wrong by a twelfth.
    allowed = max(0.1, 1.25 * abs(jump)) + wrong * 8 / 100.0
    assert np.abs(values - 1.0).max() <= allowed + 1e-12


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(0, 9_600), max_size=9))
def test_the_state_does_not_depend_on_how_the_signal_is_split(cuts):
    volts = tones(6.0, times_of(FS, 0.2))
    whole = columns(AdaptiveActuator(PAPER, FS, level=ModelLevel.NONLINEAR).move(volts))
    adaptive = AdaptiveActuator(PAPER, FS, level=ModelLevel.NONLINEAR)
    parts = [columns(adaptive.move(block)) for block in np.split(volts, sorted(cuts))]
    got = np.concatenate(parts, axis=1)
    settled = np.ones(len(volts), dtype=bool)
    for cut in cuts:
        settled[max(cut - 16, 0) : cut] = False
    # From node to node nothing differs but the roundings of two compiled loops.
    largest = np.abs(whole).max(axis=1)
    assert (np.abs(got - whole)[:, settled].max(axis=1) <= 1e-15 * largest).all()
    # Up to 15 samples before a cut are provisional: solved by narrower steps.
    assert errors(got, whole).max() < 1e-4
    assert columns(adaptive.move(np.zeros(0))).shape == (4, 0)


def test_after_reset_the_adaptive_actuator_is_as_new():
    adaptive = AdaptiveActuator(PAPER, FS, 1e-2, temperature=True)
    first = columns(adaptive.move(swell(0.3)))
    adaptive.reset()
    assert (len(adaptive.reports), adaptive.stepped_frames) == (0, 0)
    assert np.array_equal(columns(adaptive.move(swell(0.3))), first)


def test_what_the_rig_does_not_describe_cannot_be_asked_for():
    bare = replace(PAPER, seat=None, thermal=None)
    with pytest.raises(UsageError, match=r"describes no \[seat\]"):
        AdaptiveActuator(bare, FS, seat=True)
    with pytest.raises(UsageError, match=r"describes no \[thermal\]"):
        AdaptiveActuator(bare, FS, temperature=True)
    for tolerance in (0.0, -0.01, math.nan, 1.5):
        with pytest.raises(UsageError, match="above 0 and at most 1"):
            AdaptiveActuator(PAPER, FS, tolerance)
    with pytest.raises(UsageError, match="samplerate="):
        AdaptiveActuator(PAPER, 0.0)


# ----------------------------------------------------------------------------------- temperature


def test_a_steady_power_warms_coil_and_magnet_by_their_thermal_resistances():
    warm = Temperatures(THERMAL)
    for _ in range(400):
        warm.heat(10.0, 60.0)
    assert warm.magnet_k == pytest.approx(10.0 * 3.0, rel=1e-6)
    assert warm.coil_k == pytest.approx(10.0 * (4.0 + 3.0), rel=1e-6)
    hot = warm.resistance_ohm(3.3)
    assert hot == pytest.approx(3.3 * (1 + COPPER_PER_K * 70.0))
    warm.reset()
    assert warm.resistance_ohm(3.3) == 3.3


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 100), st.floats(1e-3, 100)), min_size=1, max_size=4))
def test_heat_is_kept_or_given_off_and_time_may_be_cut_anywhere(powers):
    p = THERMAL
    whole, cut = Temperatures(p), Temperatures(p)
    for power_w, duration_s in powers:
        whole.heat(power_w, duration_s)
        for _ in range(2):
            cut.heat(power_w, duration_s / 2)
    assert whole.coil_k == pytest.approx(cut.coil_k, rel=1e-9, abs=1e-9)
    put_in_j = sum(power_w * duration_s for power_w, duration_s in powers)
    kept_j = p.coil_j_per_k * whole.coil_k + p.magnet_j_per_k * whole.magnet_k
    assert -1e-9 <= kept_j <= put_in_j * (1 + 1e-9) + 1e-9


def test_a_warm_coil_draws_less_current_and_moves_less():
    volts = 12.0 * np.sin(math.tau * 60.0 * times_of(FS, 3.0))
    cold = AdaptiveActuator(PAPER, FS, 1e-3).move(volts)
    adaptive = AdaptiveActuator(PAPER, FS, 1e-3, temperature=True)
    warm = adaptive.move(volts)
    assert adaptive.temperatures is not None
    coil_k = adaptive.temperatures.coil_k
    assert 2.0 < coil_k < 12.0 * 12.0 / 2 / 3.3 * 3.0 / 8.0  # no more than without any loss
    last = slice(-FS // 4, None)
    ratio = np.abs(warm.current_a[last]).max() / np.abs(cold.current_a[last]).max()
    resisting = 1.0 / (1.0 + COPPER_PER_K * coil_k)
    assert resisting * 0.99 < ratio < 1.0
