import math
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import butter, sosfilt

from device import blocks
from device.errors import UsageError
from device.rig import CONSUMER, PAPER
from device.rig.actuator import QUANTITIES, LinearActuator
from device.rig.adaptive_actuator import MARGIN, STATE_NUMBERS, AdaptiveActuator, ModelDesign
from device.rig.co_energy import Arctangent, Hardening, Line, Stops, Tanh, energies
from device.rig.equations import Equations
from device.rig.thermal import Temperatures
from tests.support.soak import stored_energy_j
from tools.bench.measures.solved_motion import solved_motion
from tools.bench.sections.model_selection import block_errors, hard_drives

FS = 48_000
SEAT = "seat_acceleration_m_s2"
LARGE: Any = PAPER.large_signal
# White noise has a corner at every sample. Where a current settles within a sample, or where a hard
# stop turns the motion round within some, a step sees less than a whole curve.
LARGEST = {"white noise of 20 V": 1e-5, "hard stops, 100 V": 3e-5}
LARGEST |= {"inductance of 1 uH": 2e-5, "current drive, 3300 ohm": 2e-6}
Q_1000 = {"q_mechanical": 1_000.0, "force_factor_n_per_a": 0.5}
SMALL_H = {"inductance_h": 1e-6}
HARD = {"Q 1000": Q_1000, "1 uH": SMALL_H, "Q 1000 and 1 uH": Q_1000 | SMALL_H, "hard stops": {}}
HARD |= {"overdamped": {"force_factor_n_per_a": 60.0, "inductance_h": 1e-4}}
ENERGIES = energies(PAPER.actuator, PAPER.large_signal)
SHAPES = [Line(10.0), Hardening(8e4, 2e10), Arctangent(10.0, 2.6e-3), Tanh(1e-3, 0.3, 1.5e-3)]


def times_of(samplerate, duration_s):
    return np.arange(round(samplerate * duration_s)) / samplerate


def tones(level_v, times):
    hz_of = (20.0, 46.6, 92.0, 128.2, 140.9, 182.0, 220.0)
    return level_v * sum(np.sin(math.tau * hz * times) for hz in hz_of)


def columns(motion, names=QUANTITIES):
    return np.array([getattr(motion, name) for name in names])


def errors(got, expected):
    return np.abs(got - expected).max(axis=1) / np.abs(expected).max(axis=1)


@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=lambda rig: rig.name)
@pytest.mark.parametrize("seat", [False, True], ids=["ground", "seat"])
def test_the_non_linear_model_solves_the_equations(rig, seat):
    volts = tones(5.0, times_of(FS, 0.03))
    names = (*QUANTITIES, SEAT) if seat else QUANTITIES
    got = AdaptiveActuator(rig, FS, model="nonlinear", seat=seat).move(volts, names)
    expected = solved_motion(rig, FS, volts, seat=seat)[: len(names)]
    # Fourth order at 48 kHz, and tables that are off by 1e-9.
    assert errors(columns(got, names), expected).max() < 1e-7
    # It is worth it: the linear model is far off at these levels.
    linear = AdaptiveActuator(rig, FS, model="linear", seat=seat).move(volts, names)
    assert errors(columns(linear, names), expected)[0] > 0.02


@pytest.mark.parametrize("name", hard_drives(0.03))
def test_drives_that_are_hard_to_solve_are_solved(name):
    # `solve_ivp` takes half a minute for a tenth of a second of a stiff circuit.
    rig, volts = hard_drives(0.006 if name.startswith(("inductance", "current")) else 0.03)[name]
    model = AdaptiveActuator(rig, FS, model="nonlinear")
    got = columns(model.move(volts))
    assert errors(got, solved_motion(rig, FS, volts)[:4]).max() < LARGEST.get(name, 1e-7)
    assert model.unresolved_frames == 0


@pytest.mark.parametrize("samplerate", [1_000, 6_000, 192_000])
def test_a_square_is_solved_at_every_rate(samplerate):
    volts = 12.0 * np.sign(np.sin(math.tau * 70.0 * times_of(samplerate, 0.03) + 1e-9))[:1_000]
    got = columns(AdaptiveActuator(PAPER, samplerate, model="nonlinear").move(volts))
    assert errors(got, solved_motion(PAPER, samplerate, volts)[:4]).max() < 1e-7


@pytest.mark.parametrize("frequency_hz", [1_000.0, 12_090.0])
def test_content_far_above_the_vibration_does_not_come_back_as_vibration(frequency_hz):
    times = times_of(FS, 0.05)
    volts = 6.0 * np.sin(math.tau * 90.0 * times) + 6.0 * np.sin(math.tau * frequency_hz * times)
    got = AdaptiveActuator(PAPER, FS, model="nonlinear").move(volts).displacement_m
    true = solved_motion(PAPER, FS, volts)[0]
    assert np.abs(got - true).max() < 1e-5 * np.abs(true).max()


@pytest.mark.parametrize("samplerate", [1_000, 48_000, 192_000])
@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=lambda rig: rig.name)
def test_the_linear_model_is_the_linear_actuator_without_large_signal_the_truth(rig, samplerate):
    volts = tones(7.0, times_of(samplerate, 0.1))
    source = rig.amplifier.source_impedance_ohm
    exact = columns(LinearActuator(rig.actuator, samplerate, source).move(volts))
    linear = AdaptiveActuator(rig, samplerate, model="linear")
    # Two recursions round differently; short steps keep fewer digits of what they add.
    assert errors(columns(linear.move(volts)), exact).max() < 1e-9
    bare = replace(rig, large_signal=None)
    for model in ("auto", "nonlinear"):
        actuator = AdaptiveActuator(bare, samplerate, 1e-9, model=model)
        assert errors(columns(actuator.move(volts)), exact).max() < 1e-9
        assert actuator.frames_by_model["nonlinear"] == 0


def balance_of(actuator, e, volts, fine):
    """Energy from nowhere in each of (frames,) samples, and the energy that each handled, J.

    The straight lines of the voltage get `fine` points each, where the motion is known too:
    Simpson's rule then has no corner inside. A sample handles what is stored or let in.
    """
    p, frames = actuator.rig.actuator, len(volts)
    lines = np.interp(np.arange(1, frames * fine + 1) / fine, np.arange(frames + 1), [0.0, *volts])
    motion = actuator.move(lines)
    y, w, i = motion.displacement_m, motion.velocity_m_s, motion.current_a
    drag = p.damping_n_s_per_m + e.stop_loss_s_per_m * np.abs(e.stops(y)[1])
    stored_j = np.append(0.0, stored_energy_j(e, y, i) + p.moving_mass_kg * w**2 / 2)[::fine]
    weights_s = np.full(fine + 1, 2.0)
    weights_s[1::2], weights_s[[0, -1]] = 4.0, 1.0
    weights_s /= 3.0 * actuator.samplerate

    def over_samples(power_w):
        windows = np.lib.stride_tricks.sliding_window_view(np.append(0.0, power_w), fine + 1)
        return windows[::fine] @ weights_s

    let_in_j = over_samples(np.abs(lines * i))
    ohm = p.resistance_ohm + actuator.rig.amplifier.source_impedance_ohm
    kept_j = over_samples(lines * i - ohm * i**2 - drag * w**2)
    handled_j = np.maximum(np.maximum(stored_j[1:], stored_j[:-1]), let_in_j)
    return kept_j - np.diff(stored_j), handled_j, float(let_in_j.sum())


def band_noise(level_v, duration_s, seed):
    noise = np.random.default_rng(seed).standard_normal(round(FS * duration_s))
    band = sosfilt(butter(4, [20, 220], "band", fs=FS, output="sos"), noise)
    return level_v * band / np.abs(band).max()


# The last of the levels goes into the stops.
@pytest.mark.parametrize("level_v", [5.0, 20.0, 60.0])
@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=lambda rig: rig.name)
def test_no_step_makes_more_than_a_millionth_of_the_energy_that_it_handles(rig, level_v):
    e = energies(rig.actuator, rig.large_signal)
    actuator = AdaptiveActuator(rig, 4 * FS, model="nonlinear")
    surplus_j, handled_j, through_j = balance_of(actuator, e, band_noise(level_v, 0.25, 1), 4)
    some = handled_j > 1e-6 * handled_j.max()  # of less, rounding is all there is
    assert np.abs(surplus_j[some] / handled_j[some]).max() <= 1e-6
    assert np.abs(np.cumsum(surplus_j)).max() <= 1e-7 * through_j
    # A thousandth of the friction's heat that was missed would be an error of the balance.
    p = rig.actuator
    damped = replace(p, q_mechanical=0.999 * p.q_mechanical)
    actuator.reset()
    actuator.rig = replace(rig, actuator=damped)
    surplus_j, handled_j, _ = balance_of(actuator, e, band_noise(level_v, 0.25, 1), 4)
    assert np.abs(surplus_j[some] / handled_j[some]).max() > 1e-6


def test_the_linear_model_is_passive_on_random_drives():
    volts = np.random.default_rng(6).standard_normal(1_000)
    actuator = AdaptiveActuator(PAPER, 32 * FS, model="linear")
    surplus_j, _, through_j = balance_of(actuator, energies(PAPER.actuator, None), volts, 32)
    assert abs(surplus_j.sum()) <= 1e-6 * through_j


def hard_rig(case):
    large = replace(LARGE, stop_n_per_m2=1e12 if case == "hard stops" else 1.3e9)
    return replace(PAPER, actuator=replace(PAPER.actuator, **HARD[case]), large_signal=large)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(-200, 200) | st.sampled_from([math.nan, math.inf, 1e300, 1e6]), max_size=60),
    st.sampled_from([1_000, 3_000, 8_000, 44_100, 192_000]) | st.floats(1_000, 192_000),
    st.sampled_from(sorted(HARD)),
    st.sampled_from(["auto", "nonlinear", "linear"]),
    st.booleans(),
)
def test_steps_noise_and_nan_give_nothing_but_finite_motion(volts, samplerate, case, model, seat):
    actuator = AdaptiveActuator(hard_rig(case), samplerate, model=model, seat=seat)
    names = (*QUANTITIES, SEAT) if seat else QUANTITIES
    frames = int(samplerate) // 10
    drive = np.repeat([60.0, -60.0], [frames // 4, frames - frames // 4])
    drive[frames // 2 :] = 40.0 * np.random.default_rng(7).standard_normal(frames - frames // 2)
    drive[frames // 3], drive[frames // 3 + 1] = math.nan, -math.inf
    motion = columns(actuator.move(drive, names), names)
    assert (np.isfinite(motion).all(), actuator.replaced_samples) == (True, 2)
    # Finite means bounded as well: even these stops give way by less than their own distance.
    assert model == "linear" or np.abs(motion[0]).max() < 3 * LARGE.stop_m
    motion = columns(actuator.move(np.array(volts, float), names), names)
    assert (np.isfinite(motion).all(), motion.shape) == (True, (len(names), len(volts)))


def test_a_stop_that_no_step_can_follow_holds_like_a_wall_and_is_counted():
    rig = replace(PAPER, large_signal=replace(LARGE, stop_n_per_m2=1e24))
    actuator = AdaptiveActuator(rig, FS, model="nonlinear")
    motion = actuator.move(60.0 * np.sin(math.tau * 80.0 * times_of(FS, 0.1)))
    assert 0 < actuator.unresolved_frames < 1_000
    assert np.abs(motion.displacement_m).max() == pytest.approx(LARGE.stop_m, rel=1e-3)
    actuator.reset()
    assert actuator.unresolved_frames == 0


@pytest.mark.parametrize("model", ["auto", "nonlinear"])
def test_left_alone_the_motion_dies_away_over_a_million_samples(model):
    actuator = AdaptiveActuator(hard_rig("Q 1000"), FS, model=model)
    actuator.move(tones(1.0, times_of(FS, 0.5)))
    peaks = [np.abs(actuator.move(np.zeros(FS)).displacement_m).max() for _ in range(20)]
    assert all(after < before for before, after in pairwise(peaks))
    # Q 1000 at 90 Hz: amplitude falls by exp(-pi 90 / 1000) a second, a little more by Bl.
    assert peaks[-1] < peaks[0] * math.exp(-0.27 * 18)


PAPERS = ModelDesign(Equations(PAPER.actuator, energies(PAPER.actuator, LARGE)), FS, 1e-2)
NUMBERS = [0, 480, 480, 4_800, 2]
GOOD = {"volts": np.zeros(480), "moved": np.zeros((4, 480)), "design": PAPERS.arrays}
GOOD |= {"state": np.zeros(STATE_NUMBERS), "report": np.zeros((2, 2)), "numbers": NUMBERS}
SMALL = {"volts": 479, "moved": (3, 480), "state": 3, "report": (0, 2)}
BAD: list[dict[str, Any]] = [
    *({name: np.zeros(shape)} for name, shape in SMALL.items()),
    *({"numbers": [*NUMBERS[:at], n, *NUMBERS[at + 1 :]]} for at, n in ((1, 481), (2, 0), (4, 3))),
    {"numbers": [5, 4, 480, 4_800, 2]},
    *(
        {"design": [*PAPERS.arrays[:place], np.zeros(3), *PAPERS.arrays[place + 1 :]]}
        for place in range(len(PAPERS.arrays))
    ),
]


def test_arrays_that_do_not_fit_are_refused():
    compiled: Any = blocks.compiled
    compiled.move_rig(*GOOD.values())
    for bad in BAD:
        with pytest.raises(ValueError, match="part of the volts" if "numbers" in bad else ":"):
            compiled.move_rig(*(GOOD | bad).values())


def test_without_what_is_compiled_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setattr(blocks, "compiled", None)
    with pytest.raises(UsageError, match="install a C compiler"):
        AdaptiveActuator(PAPER, FS)


@pytest.mark.parametrize("shape", [*SHAPES, Stops(2.2e-3, 1.3e9)])
def test_each_derivative_of_a_shape_is_the_slope_of_the_one_before(shape):
    x, step = np.linspace(-2.9e-3, 2.9e-3, 801), 1e-7
    before, after, here = shape(x - step), shape(x + step), shape(x)
    for order in range(2):
        slope = (after[order] - before[order]) / (2 * step)
        # Central differences: (step / 1.5 mm)^2 = 4e-9, and rounding of the difference, 1e-16
        # of 3 mm over the step, 3e-12; where a stop begins f''' jumps, and the slope is off by
        # one step of f''.
        allowed = 1e-7 * np.abs(slope).max() + step * 2 * getattr(shape, "hardness", 2.6e9)
        assert np.abs(slope - here[order + 1]).max() <= allowed


@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=lambda rig: rig.name)
def test_at_x_max_the_shapes_have_changed_as_the_table_of_the_rig_says(rig):
    e, p = energies(rig.actuator, rig.large_signal), rig.actuator
    x = np.array([0.0, p.x_max_m, -p.x_max_m])
    assert e.magnet(x)[1] / p.force_factor_n_per_a == pytest.approx([1.0, 0.75, 0.75])
    stiffness = e.spring(x)[1][1:] / x[1:]
    assert stiffness / p.stiffness_n_per_m == pytest.approx([1.5, 1.5])
    assert e.inductance(x)[0] / p.inductance_h == pytest.approx([1.0, 0.77, 1.23], abs=0.002)


@given(st.floats(-3e-3, 3e-3), st.floats(-7, 7))
def test_the_stored_energy_is_never_negative(x, i):
    assert stored_energy_j(ENERGIES, np.array([x]), np.array([i]))[0] >= 0.0


THERMAL: Any = PAPER.thermal
MODELS = st.sampled_from(["linear", "nonlinear"])


def swell(duration_s=1.6):
    """Tones from a whisper to beyond Xmax and back."""
    times = times_of(FS, duration_s)
    shares = np.array([0, 0.3, 0.6, 0.75, 1]) * duration_s
    return np.interp(times, shares, [0.02, 0.4, 8.0, 0.05, 0.0]) * tones(1.0, times)


def moved_by(actuator, parts, names=QUANTITIES):
    return np.concatenate([columns(actuator.move(part), names) for part in parts], axis=1)


def noise(level_v, duration_s, seed=1):
    return level_v * np.random.default_rng(seed).standard_normal(round(duration_s * FS))


def music(level_v, duration_s, seed=2):
    sections = butter(2, [20, 1_000], "band", fs=FS, output="sos")
    band = sosfilt(sections, noise(1.0, duration_s, seed))
    envelope = 0.3 + 0.7 * np.abs(np.sin(math.tau * 0.7 * times_of(FS, duration_s))) ** 3
    return level_v * band * envelope / np.abs(band).max()


@cache
def scenes(duration_s):
    # A quiet block after a loud one has the smaller peak, and what the loud one left behind.
    times = times_of(FS, 0.25)
    edge = np.minimum(1.0, np.minimum(times, times[::-1]) / 0.005)
    parts = []
    for random in map(np.random.default_rng, range(round(4 * duration_s))):
        level_v = 40.0 * 10.0 ** random.uniform(-3.0, 0.0)
        parts.append(level_v * edge * np.sin(math.tau * 20.0 * 11.0 ** random.random() * times))
    bursts, part = np.concatenate(parts), times_of(FS, duration_s / 5)
    levels = ((15, 90), (3, 40), (0.5, 33), (8, 60), (0.2, 120))
    squares = [level_v * np.sign(np.sin(math.tau * hz * part + 1e-9)) for level_v, hz in levels]
    return {
        "bursts": bursts,
        "mostly silence": bursts * np.repeat(np.arange(4 * duration_s) % 5 == 0, FS // 4),
        "swell": np.resize(swell(), round(duration_s * FS)),
        "quiet music": music(1.0, duration_s),
        "loud music": music(20.0, duration_s),
        "tones": 3.0 * np.sin(math.tau * 46.6 * times_of(FS, duration_s)),
        "squares": np.concatenate(squares),
        "noise": noise(20.0, duration_s),
        "faint noise": noise(0.3, duration_s),
    }


# 10 scenes of 15 s at six tolerances, 1 500 blocks at each; in `make soak` of 40 s.
@pytest.mark.parametrize(
    "duration_s",
    [5, pytest.param(15, marks=pytest.mark.exhaustive), pytest.param(40, marks=pytest.mark.soak)],
)
@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=lambda rig: rig.name)
@pytest.mark.parametrize("scene", [*scenes(5), "swell on a seat"])
def test_no_block_is_beyond_the_tolerance(scene, rig, duration_s):
    name, _, seat = scene.partition(" on a ")
    volts = scenes(duration_s)[name]
    true = AdaptiveActuator(rig, FS, model="nonlinear", refine=1, seat=bool(seat)).move(volts)
    for tolerance in (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 1e-4):
        actuator = AdaptiveActuator(rig, FS, tolerance, seat=bool(seat))
        wrong = block_errors(actuator.reports, actuator.move(volts), true, rig.actuator)
        assert len(wrong) >= 9 * duration_s
        assert wrong.max() <= tolerance
        assert max(block.estimate for block in actuator.reports) <= tolerance


def test_the_estimate_is_the_error_of_a_linear_block_with_its_margin():
    actuator = AdaptiveActuator(PAPER, FS, 1e-2)
    volts = 0.5 * np.sin(math.tau * 60.0 * times_of(FS, 1.0))
    true = AdaptiveActuator(PAPER, FS, model="nonlinear", refine=1).move(volts)
    motion = actuator.move(volts)
    wrong = block_errors(actuator.reports, motion, true, PAPER.actuator)
    told = np.array([block.estimate for block in actuator.reports])
    # It sees 6 kHz of the motion, and what is left out of what is left out is a hundredth.
    assert told == pytest.approx(MARGIN * wrong, rel=0.05)


def test_the_dearer_model_runs_only_where_it_has_to():
    loose, tight = AdaptiveActuator(PAPER, FS, 3e-2), AdaptiveActuator(PAPER, FS, 1e-3)
    for actuator in (loose, tight):
        actuator.move(swell())
    used = loose.frames_by_model
    assert min(used.values()) > 0
    assert tight.frames_by_model["nonlinear"] > used["nonlinear"]
    assert sum(used.values()) == sum(report.frames for report in loose.reports) == len(swell())
    times, actuator = times_of(FS, 3.0), AdaptiveActuator(PAPER, FS, 1e-2)
    actuator.move(np.where(times < 1.5, 12.0, 0.05) * np.sin(math.tau * 70.0 * times))
    assert {one.model for one in actuator.reports if one.frame < FS} == {"nonlinear"}
    assert {one.model for one in actuator.reports if one.frame > 1.8 * FS} == {"linear"}


@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=lambda rig: rig.name)
@pytest.mark.parametrize("tolerance", [3e-2, 1e-2, 3e-3])
def test_where_the_model_changes_the_motion_goes_on(rig, tolerance):
    times = times_of(FS, 1.6)
    envelope = 0.4 + 3.0 * np.sin(math.pi * times / 1.6) ** 2
    volts = envelope * (np.sin(math.tau * 46.6 * times) + np.sin(math.tau * 92.0 * times))
    actuator = AdaptiveActuator(rig, FS, tolerance)
    motion, pairs = actuator.move(volts), pairwise(actuator.reports)
    changes = [report.frame for before, report in pairs if report.model != before.model]
    assert changes or tolerance < 1e-2
    for rows, allowed in ((columns(motion)[:3], 1e-3), (columns(motion)[3:], tolerance)):
        for row in rows:
            bend = np.abs(np.diff(row, 2))
            # Excursion, speed and current are handed over: their curves have at most a kink.
            # The force that the linear model leaves out comes at once, under the tolerance.
            peaks = [np.abs(row[max(0, at - 4_800) : at + 4_800]).max() for at in changes]
            for at, peak in zip(changes, peaks, strict=True):
                assert bend[at - 3 : at + 2].max() <= allowed * peak + 1.5 * np.median(bend)


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(0, 9_600), max_size=9), MODELS, st.booleans())
def test_one_model_gives_the_same_bytes_however_the_signal_is_split(cuts, model, seat):
    volts, names = tones(6.0, times_of(FS, 0.2)), ("displacement_m", "acceleration_m_s2")
    whole, cut = (AdaptiveActuator(PAPER, FS, model=model, seat=seat) for _ in range(2))
    expected = moved_by(whole, [volts], names)
    assert moved_by(cut, np.split(volts, sorted(cuts)), names).tobytes() == expected.tobytes()
    assert moved_by(cut, [np.zeros(0)], names).shape == (2, 0)


def test_after_reset_the_choice_gives_the_same_bytes_for_parts_that_end_with_a_block():
    actuator = AdaptiveActuator(PAPER, FS, 1e-2)
    whole = moved_by(actuator, [swell()])
    actuator.reset()
    assert (len(actuator.reports), sum(actuator.frames_by_model.values())) == (0, 0)
    parts = np.split(swell(), range(actuator.block_frames, len(swell()), 3 * actuator.block_frames))
    assert np.array_equal(moved_by(actuator, parts), whole)


@pytest.mark.parametrize("frames", [1, 7, 100])
def test_the_tolerance_holds_in_parts_of_any_length(frames):
    volts = swell(0.4)
    true = AdaptiveActuator(PAPER, FS, model="nonlinear", refine=1).move(volts)
    actuator = AdaptiveActuator(PAPER, FS, 1e-2)
    got = moved_by(actuator, np.split(volts, range(frames, len(volts), frames)))
    # Such a part has no peak of its own; that of the signal is larger.
    assert errors(got[[0, 3]], columns(true)[[0, 3]]).max() < 1e-2
    assert min(actuator.frames_by_model.values()) > 0


def test_what_the_rig_does_not_describe_cannot_be_asked_for():
    bare = replace(PAPER, seat=None)
    with pytest.raises(UsageError, match=r"describes no \[seat\]"):
        AdaptiveActuator(bare, FS, seat=True)
    for tolerance in (0.0, -0.01, math.nan, 1.5):
        with pytest.raises(UsageError, match="above 0 and at most 1"):
            AdaptiveActuator(PAPER, FS, tolerance)
    for samplerate in (0.0, -1.0, math.nan):
        with pytest.raises(UsageError, match="samplerate="):
            AdaptiveActuator(PAPER, samplerate)


@pytest.mark.parametrize(("step_s", "steps"), [(0.002, 20_000), (60.0, 400)])
def test_coil_and_magnet_warm_up_by_their_equations_in_steps_of_any_length(step_s, steps):
    p, warm = THERMAL, Temperatures(THERMAL)
    assert warm.resistance_ohm(3.3) == 3.3
    for _ in range(steps):
        warm.heat(10.0, step_s)

    def slope(_, warm_k):
        onward_w = (warm_k[0] - warm_k[1]) / p.coil_k_per_w
        magnet_w = onward_w - warm_k[1] / p.magnet_k_per_w
        return [(10.0 - onward_w) / p.coil_j_per_k, magnet_w / p.magnet_j_per_k]

    solved = solve_ivp(slope, (0.0, step_s * steps), [0.0, 0.0], "LSODA", rtol=1e-10, atol=1e-10)
    assert [warm.coil_k, warm.magnet_k] == pytest.approx(solved.y[:, -1], rel=1e-7)
    assert warm.resistance_ohm(3.3) == pytest.approx(3.3 * (1 + 0.00393 * warm.coil_k))  # copper
