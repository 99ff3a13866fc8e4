"""The compiled non-linear model: against its readable form, rough drives, and its own error."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import butter, sosfilt

from device import blocks
from device.rig import CONSUMER, PAPER
from device.rig.actuator import QUANTITIES
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.co_energy import energies
from device.rig.equations import Equations
from device.rig.model_levels import ModelLevel
from device.rig.nonlinear_model import FLOOR, STEP_TOLERANCE, NonlinearModel, Path, ReadableModel
from device.rig.step_maps import grid_of, step_maps, table_of

EXHAUSTIVE = pytest.mark.exhaustive
FS = 48_000
assert PAPER.large_signal
LARGE = PAPER.large_signal
SEAT = "seat_acceleration_m_s2"


def times_of(duration_s, samplerate=FS):
    return np.arange(round(duration_s * samplerate)) / samplerate


def square(level_v, hz, duration_s):
    return level_v * np.sign(np.sin(math.tau * hz * times_of(duration_s) + 1e-9))


def noise(level_v, duration_s, seed=1):
    return level_v * np.random.default_rng(seed).standard_normal(round(duration_s * FS))


def music(level_v, duration_s, seed=2):
    sections = butter(2, [20, 1_000], "band", fs=FS, output="sos")
    band = sosfilt(sections, noise(1.0, duration_s, seed))
    envelope = 0.3 + 0.7 * np.abs(np.sin(math.tau * 0.7 * times_of(duration_s))) ** 3
    return level_v * band * envelope / np.abs(band).max()


def game(level_v, duration_s, seed=5):
    """Thumps, shots and a rumble, full scale now and then."""
    random = np.random.default_rng(seed)
    out = 0.1 * sosfilt(
        butter(2, [20, 220], "band", fs=FS, output="sos"), noise(1.0, duration_s, 6)
    )
    for start in np.cumsum(random.uniform(0.05, 0.4, round(6 * duration_s))):
        first = round(start * FS)
        if first >= len(out):
            break
        time = np.arange(min(len(out) - first, FS // 3)) / FS
        hit = np.exp(-time / random.uniform(0.02, 0.1)) * random.uniform(0.2, 1.0)
        out[first : first + len(time)] += hit * np.sin(math.tau * random.uniform(25, 200) * time)
    return level_v * np.clip(out, -1.0, 1.0)


def columns(motion, names=QUANTITIES):
    return np.array([getattr(motion, name) for name in names])


def errors(got, expected):
    return np.abs(got - expected).max(axis=1) / np.abs(expected).max(axis=1)


# ------------------------------------------------------------------------------- the same twice


@pytest.mark.parametrize("seat", [False, True], ids=["ground", "seat"])
@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=lambda rig: rig.name)
def test_the_compiled_model_agrees_with_the_readable_one(rig, seat, monkeypatch):
    # From below the stops into them, with an edge.
    volts = 30.0 * np.sin(math.tau * 60.0 * times_of(0.02)) * np.minimum(1.0, times_of(0.02) / 0.01)
    volts[480:] -= 10.0
    options = {"level": ModelLevel.NONLINEAR, "seat": seat}
    names = (*QUANTITIES, SEAT) if seat else QUANTITIES
    compiled = columns(
        AdaptiveActuator(rig, FS, step_tolerance=1e-7, **options).move(volts, names), names
    )
    monkeypatch.setattr(blocks, "compiled", None)
    readable = columns(AdaptiveActuator(rig, FS, **options).move(volts, names), names)
    # The readable one takes whole samples: the fourth order of its steps, and what a stop bends.
    assert errors(compiled, readable).max() < 2e-5


def test_where_nothing_is_compiled_auto_takes_the_non_linear_model(monkeypatch):
    monkeypatch.setattr(blocks, "compiled", None)
    adaptive = AdaptiveActuator(PAPER, FS, 1e-2)
    adaptive.move(np.full(480, 5.0))
    assert adaptive.frames_by_level[ModelLevel.LINEAR] == 0


def test_a_step_without_remainder_is_exact_and_a_constant_one_as_well():
    equations = Equations(PAPER.actuator, energies(PAPER.actuator, None))
    scale = equations.scale
    rate = scale[:, None] * equations.rate / scale
    entry = scale[:, None] * equations.entry
    rates, vectors = np.linalg.eig(rate)
    for one in step_maps(PAPER.actuator, 0.0, None, grid_of(FS)):
        for point, share in enumerate((0.5, 1.0)):
            grown = np.exp(rates * share * one.width_s)
            exact = (vectors * grown @ np.linalg.inv(vectors)).real
            onward = scale[:, None] * one.onward[point] / scale
            assert np.abs(onward - exact).max() < 1e-12
            total = scale[:, None] * one.weights[point].sum(axis=0)
            steady = np.linalg.solve(rate, (exact - np.eye(3)) @ entry)
            assert np.abs(total - steady).max() < 1e-9 * np.abs(steady).max()


@pytest.mark.parametrize("change", [{}, {"force_factor_loss": 0.9}, {"inductance_change": 0.9}])
def test_the_tables_say_what_the_energies_say(change):
    e = energies(PAPER.actuator, replace(LARGE, **change))
    table = table_of(e, PAPER.actuator.x_max_m)
    x = np.random.default_rng(4).uniform(-0.999, 0.999, 2_000) * -table.lowest_m
    place = (x - table.lowest_m) * table.intervals_per_m
    share = place - np.floor(place)
    cubics = table.rows[place.astype(int)].reshape(-1, 4, 4)
    got = np.einsum("pfk,pk->fp", cubics, share[:, None] ** np.arange(4))
    _, force_factor, _ = e.co_energy.magnet.jet(x)
    inductance, slope, _ = e.co_energy.inductance.jet(x)
    spring = e.potential.jet(x)[1] - e.stops.jet(x)[1]
    for one, expected in zip(got, (force_factor, 1 / inductance, slope / 2, spring), strict=True):
        assert np.abs(one - expected).max() < 3e-9 * np.abs(expected).max()


# ---------------------------------------------------------------------------- rough drives, stops


@cache
def drives():
    sine = np.sin(math.tau * 80.0 * times_of(0.5))
    return {
        "square": (PAPER, square(15.0, 90.0, 0.5)),
        "slow square": (PAPER, square(6.0, 33.0, 0.5)),
        "noise": (PAPER, noise(20.0, 0.5)),
        "music": (PAPER, music(9.0, 0.5)),
        "stops": (PAPER, 60.0 * sine),
        "hard stops": (
            replace(PAPER, large_signal=replace(LARGE, stop_n_per_m2=1e12)),
            100.0 * sine,
        ),
        "1 uH": (replace(PAPER, actuator=replace(PAPER.actuator, inductance_h=1e-6)), 8.0 * sine),
        "current drive": (
            replace(
                PAPER,
                amplifier=replace(
                    PAPER.amplifier, source_impedance_ohm=3_300.0, drive_mode="current"
                ),
            ),
            5_000.0 * sine,
        ),
    }


@pytest.mark.parametrize("drive", drives())
def test_the_excursion_is_right_to_a_ten_thousandth_whatever_the_drive(drive):
    rig, volts = drives()[drive]
    fine = AdaptiveActuator(rig, FS, level=ModelLevel.NONLINEAR, step_tolerance=1e-7)
    true = columns(fine.move(volts))
    adaptive = AdaptiveActuator(rig, FS, level=ModelLevel.NONLINEAR)
    got = columns(adaptive.move(volts))
    assert adaptive.stepped_frames == fine.stepped_frames == 0
    assert errors(got, true)[0] <= 1e-4
    # Acceleration as steps are allowed to be off, and a margin for what samples between show.
    assert errors(got, true)[3] <= 3 * STEP_TOLERANCE


@pytest.mark.parametrize("samplerate", [1_000, 6_000, 192_000])
def test_a_square_is_solved_at_every_rate(samplerate):
    p, e = PAPER.actuator, energies(PAPER.actuator, LARGE)
    times = times_of(0.03, samplerate)
    volts = 12.0 * np.sign(np.sin(math.tau * 70.0 * times + 1e-9))
    magnet, inductance = e.co_energy.magnet, e.co_energy.inductance

    def rates(t, state, first, last, start, width):
        y, u, i = state
        factor, slope = magnet.divided(y, y), inductance.divided(y, y)
        volt = first + (last - first) * (t - start) / width
        force = (factor + 0.5 * slope * i) * i - e.potential.divided(y, y)
        force -= p.damping_n_s_per_m * u
        change = volt - p.resistance_ohm * i - (factor + slope * i) * u
        return [u, force / p.moving_mass_kg, change / inductance.value(y)]

    state, before, found, width = np.zeros(3), 0.0, [], 1.0 / samplerate
    steps = 200 * samplerate // 10_000 if samplerate > 10_000 else len(volts)
    for index, volt in enumerate(volts[:steps].tolist()):
        start = index * width
        solved = solve_ivp(
            rates, (start, start + width), state, "DOP853", rtol=1e-11, atol=1e-13,
            args=(before, volt, start, width),
        )  # fmt: skip
        state, before = solved.y[:, -1], volt
        found.append(state)
    got = columns(AdaptiveActuator(PAPER, samplerate, level=ModelLevel.NONLINEAR).move(volts))
    assert errors(got[:3, :steps], np.array(found).T)[0] <= 1e-4


# -------------------------------------------------------------------------------- measured error


@cache
def scenes(duration_s):
    bursts = np.concatenate(
        [
            40.0 * 10.0 ** random.uniform(-3.0, 0.0)
            * np.minimum(1.0, np.minimum(times_of(0.25), times_of(0.25)[::-1]) / 0.005)
            * np.sin(math.tau * 20.0 * 11.0 ** random.random() * times_of(0.25))
            for random in map(np.random.default_rng, range(round(4 * duration_s)))
        ]
    )  # fmt: skip
    squares = np.concatenate(
        [
            square(level_v, hz, duration_s / 5)
            for level_v, hz in ((15, 90), (3, 40), (0.5, 33), (8, 60), (0.2, 120))
        ]
    )
    return {
        "bursts": bursts,
        "mostly silence": bursts * np.repeat(np.arange(4 * duration_s) % 5 == 0, FS // 4),
        "quiet music": music(1.0, duration_s),
        "loud music": music(20.0, duration_s),
        "tones": 3.0 * np.sin(math.tau * 46.6 * times_of(duration_s)),
        "squares": squares,
        "noise": noise(20.0, duration_s),
        "game": game(22.0, duration_s),
    }


def block_errors(adaptive, motion, true):
    p = PAPER.actuator
    floors = {"displacement_m": FLOOR * p.x_max_m}
    floors["acceleration_m_s2"] = floors["displacement_m"] * p.resonance_rad_s**2
    found = []
    for block in adaptive.reports:
        part = slice(block.frame, block.frame + block.frames)
        shares = []
        for name, floor in floors.items():
            got, expected = getattr(motion, name)[part], getattr(true, name)[part]
            shares.append(np.abs(got - expected).max() / max(np.abs(expected).max(), floor))
        found.append(max(shares))
    return np.array(found)


@cache
def truth(scene, duration_s):
    fine = AdaptiveActuator(PAPER, FS, level=ModelLevel.NONLINEAR, step_tolerance=1e-6)
    return fine.move(scenes(duration_s)[scene])


# In full: 8 scenes of 40 s at five tolerances, 3 200 blocks at each.
@pytest.mark.parametrize("duration_s", [5, pytest.param(40, marks=EXHAUSTIVE)])
@pytest.mark.parametrize("tolerance", [1e-1, 3e-2, 1e-2, 3e-3, 1e-3])
@pytest.mark.parametrize("scene", scenes(5))
def test_no_block_is_beyond_the_tolerance(scene, tolerance, duration_s):
    adaptive = AdaptiveActuator(PAPER, FS, tolerance)
    motion = adaptive.move(scenes(duration_s)[scene])
    wrong = block_errors(adaptive, motion, truth(scene, duration_s))
    assert len(wrong) >= 9 * duration_s
    assert np.count_nonzero(wrong > tolerance) == 0, wrong.max() / tolerance
    assert max(block.estimate for block in adaptive.reports) <= tolerance


@pytest.mark.parametrize("scene", scenes(5))
def test_the_reported_error_is_that_of_the_block(scene):
    adaptive = AdaptiveActuator(PAPER, FS, level=ModelLevel.NONLINEAR)
    wrong = block_errors(adaptive, adaptive.move(scenes(5)[scene]), truth(scene, 5))
    told = np.array([block.estimate for block in adaptive.reports])
    # Of the roughest drives some samples show up to six times what the steps' points say.
    assert (wrong <= 6.0 * told + 1e-5).all(), (wrong / told).max()
    assert told.max() <= STEP_TOLERANCE * 1.5


def test_a_path_is_a_view_that_can_be_copied():
    path = Path()
    path.d[0] = 1.0
    other = path.copy()
    path.d[0] = 2.0
    assert (path.numbers[0], other.d[0]) == (2.0, 1.0)


def test_arrays_that_do_not_fit_are_refused():
    compiled: Any = blocks.compiled
    if compiled is None:
        pytest.skip("nothing is compiled here")
    model = NonlinearModel(Equations(PAPER.actuator, energies(PAPER.actuator, LARGE)), FS)
    volts, moved, path = np.zeros(480), np.zeros((5, 480)), Path()
    good = [volts, moved, *model._arrays, path.numbers, np.zeros((2, 4))]
    numbers = [0, 480, 480, 4_800, 15]
    assert compiled.nonlinear_motion(*good, *numbers) == 480
    for place in range(len(good)):
        bad = list(good)
        bad[place] = np.zeros(3)
        with pytest.raises((TypeError, ValueError)):
            compiled.nonlinear_motion(*bad, *numbers)
    for wrong in ([0, 481, 480, 4_800, 15], [5, 4, 480, 4_800, 15], [0, 480, 0, 4_800, 15]):
        with pytest.raises(ValueError, match="part of the volts"):
            compiled.nonlinear_motion(*good, *wrong)
    assert ReadableModel(model)._first == 4
