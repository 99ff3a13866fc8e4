import math
from dataclasses import replace
from itertools import product
from operator import attrgetter

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.signal import sosfilt

from device.drive.exposure import ACTION_A8_M_S2, ACTION_VDV, DAY_S, DoseSums
from device.drive.protection.design import RESERVE, Limits, bounding_models, limits_of
from device.drive.safety import SafetyState
from device.rig import CONSUMER, PAPER
from device.rig.electronics import Band
from device.rig.parameters import vary
from tests.support import possible_actuators as made
from tests.support.possible_actuators import FREE, Possible, linear_excursions, strong
from tests.support.random_drives import OFF, RIGS, Case, driven, reached
from tools.bench.sections.protection import drives
from tools.bench.sounds.signals import SAMPLERATE
from tools.rig_driver import RigDriver

MOST = {"excursion": 1.0, "current": 1.0, "coil_c": Limits.coil_temperature_c, "infeasible": 0}
CAPS = pytest.mark.parametrize("cap", ["off", "action"])


def check_limits(found, cap):
    """No case is beyond a limit, whichever it is, and with a cap no day's dose is."""
    for name, most in MOST.items():
        worst = max(found, key=attrgetter(name))
        print(f"{len(found)} drives, {name}: {getattr(worst, name):.4f}")
        assert getattr(worst, name) <= most, worst
    assert sum(one.limited > 0 for one in found) > 0.5 * len(found)
    if cap != "off":
        assert all(one.gain < 1.0 for one in found)
        assert max(one.dose.vdv for one in found) < ACTION_VDV
        assert max(one.dose.a8_m_s2 for one in found) < ACTION_A8_M_S2


@pytest.mark.parametrize(
    ("count", "samplerate"),
    [
        (40, 6_000),
        (12, 44_100),
        (12, 48_000),
        (12, 176_400),
        # 36 pairs of a rig and a kind of drive: each 41 times or more, and at 48 kHz once or twice.
        pytest.param(1_500, 6_000, marks=pytest.mark.exhaustive),
        pytest.param(60, 48_000, marks=pytest.mark.exhaustive),
        pytest.param(6_000, 6_000, marks=pytest.mark.soak),
        pytest.param(240, 48_000, marks=pytest.mark.soak),
    ],
)
@CAPS
def test_no_drive_of_a_generator_takes_a_rig_that_is_a_tenth_off_beyond_a_limit(
    count, samplerate, cap
):
    found = reached(range(count), cap, samplerate)
    check_limits(found, cap)
    if cap == "off":  # they do come near: 9.1 % of Xmax and of the current are held back
        assert min(max(one.excursion for one in found), max(one.current for one in found)) > 0.7


@CAPS
def test_no_drive_of_the_bench_takes_a_rig_that_is_a_tenth_off_beyond_a_limit(cap):
    share, rig, found = 0.0 if cap == "off" else 0.9, RIGS[0], []
    dose = DoseSums(0.0, share * ACTION_A8_M_S2**2 * DAY_S, share * ACTION_VDV**4)
    for mass, f0, force_factor in product((1.0 - OFF, 1.0 + OFF), repeat=3):
        true = replace(rig, actuator=vary(rig.actuator, mass, f0**2, force_factor))
        begins = SafetyState(119.0, 60.0, dose)
        cases = [Case(name, drive, rig, true, begins) for name, drive in drives().items()]
        found += driven(cases, SAMPLERATE, cap)
    check_limits(found, cap)


RATE = 8_000
LOUD = replace(PAPER, amplifier=replace(PAPER.amplifier, gain=20.0, current_limit_a=math.inf))
STANDARD = pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=["paper", "consumer"])
ACTUATORS = ((0.9, 1.1), (0.81, 1.21), (0.9, 1.1), (0.0, 3.0 - 1e-6))  # mass, stiffness, Bl, seat
EXCURSION_MOST = {True: 1.0, False: 1.1}  # of Xmax: of the linear models, and of the non-linear one


def worst(rig, stronger, linear, **effort):
    """The largest excursion of any possible actuator, for the worst drive that is found.

    Of the non-linear model, the actuator is searched as well.
    """
    loud, drives = strong(rig, stronger), effort["drives"]
    protector = RigDriver(loud, RATE, drives)
    silence = np.zeros((protector.latency_frames + RATE // 20, drives))

    def reached(tries):
        waves = [made.searched_drive(rig.actuator.resonance_hz, RATE, each[:7]) for each in tries]
        protector.reset()
        out = protector.process(np.concatenate([np.column_stack(waves), silence])).astype(float)
        if linear:
            assert protector.protection().infeasible_blocks == 0
            possible = made.possible_actuators(rig)
            return np.max([linear_excursions(loud, one, out, RATE) for one in possible], axis=0)
        found = []
        for (mass, stiffness, bl, seat), column in zip(tries[:, 7:], out.T, strict=True):
            one = Possible(mass, stiffness, bl, (made.GROUND, rig.seat, FREE)[int(seat)])
            found.append(made.non_linear_excursion(loud, one, column, RATE))
        return np.array(found)

    return made.search(reached, made.DRIVES if linear else made.DRIVES + ACTUATORS, **effort)


def several(mark, stronger, drives, generations):
    """Searches of both models, the seed of each, and the least that they must reach."""
    for linear, seed in ((True, 2), (False, 3)):
        yield pytest.param(linear, stronger, drives, generations, seed, 0.0, marks=mark)


@STANDARD
@pytest.mark.parametrize(
    ("linear", "stronger", "drives", "generations", "seed", "least"),
    [
        *((True, 2.5, 32, 2, 1, 0.85), (False, 4.0, 16, 1, 1, 0.6)),
        # 504 drives of each; `make soak` tries twice as many, and ten times as many.
        *(one for share in (1.5, 4.0) for one in several(pytest.mark.exhaustive, share, 24, 20)),
        *(one for share in (1.5, 2.5, 4.0) for one in several(pytest.mark.soak, share, 48, 20)),
        *(one for share in (1.5, 2.5, 4.0) for one in several(pytest.mark.soak, share, 64, 80)),
    ],
)
def test_no_drive_found_is_too_much(rig, linear, stronger, drives, generations, seed, least):
    effort = {"drives": drives, "generations": generations, "seed": seed}
    reached, found, tries = worst(rig, stronger, linear, **effort)
    print(f"{rig.name}, {stronger} Xmax: {tries} drives, {linear=}: {reached:.4f} by {found}")
    assert tries >= drives * generations
    assert least < reached <= EXCURSION_MOST[linear]


def largest_inside_the_models(loud, possible_ones, rate):
    """Each possible actuator with its largest excursion over all drives, the largest first.

    By linear programming: no optimiser can find more. The models stay inside what is allowed.
    """
    p = loud.actuator
    models = bounding_models(p, limits_of(loud), loud.amplifier.source_impedance_ohm)
    assert len(models) <= 10
    frames = 5 * rate // round(p.resonance_hz)
    volts = loud.dac.full_scale_v * loud.amplifier.gain
    band = Band(loud.amplifier.low_cut_hz, math.inf, rate).sections

    delay = np.arange(frames)[:, None] - np.arange(frames)

    def matrix(possible):
        """The lower triangular matrix from a drive to what an actuator makes of it."""
        sections = np.concatenate([band, made.excursion_sections(loud, possible, rate)])
        impulse = sosfilt(sections, np.eye(1, frames)[0])
        return volts * np.where(delay >= 0, impulse[np.abs(delay)], 0.0)

    names = ("moving_mass_kg", "stiffness_n_per_m", "force_factor_n_per_a")
    shares = [[getattr(model, name) / getattr(p, name) for name in names] for model in models]
    inside = np.vstack([matrix(Possible(*each)) for each in shares])
    limit, both = np.full(2 * len(inside), 1.0 - RESERVE), np.vstack([inside, -inside])
    limits = {"A_ub": both, "b_ub": limit, "bounds": (-1.0, 1.0)}
    found = [(-linprog(-matrix(one)[-1], **limits).fun, one) for one in possible_ones]
    return sorted(found, key=lambda each: -each[0])


@pytest.mark.exhaustive
@pytest.mark.parametrize("again", [1, pytest.param(3, marks=pytest.mark.soak)])
@STANDARD
def test_while_the_models_stay_inside_no_possible_actuator_is_beyond_xmax(rig, again):
    # The worst at the lower rate are looked at again with three times as many samples.
    loud, rate = strong(rig, 4.0), 2_000 if rig is PAPER else 1_000
    found = largest_inside_the_models(loud, made.possible_actuators(rig), rate)
    finer = largest_inside_the_models(loud, [one for _, one in found[:again]], 3 * rate)
    assert max(found[0][0], finer[0][0]) <= 1.0


def test_a_frame_that_moves_freely_makes_the_mass_lighter():
    drive = np.sin(math.tau * 85.0 * np.arange(2_400) / RATE)[:, None]
    lighter = Possible(mass=FREE.mass_kg / (FREE.mass_kg + PAPER.actuator.moving_mass_kg))
    free = linear_excursions(LOUD, Possible(seat=FREE), drive, RATE)
    # The board's own 2 Hz are the difference.
    assert free == pytest.approx(linear_excursions(LOUD, lighter, drive, RATE), rel=2e-3)


@STANDARD
def test_the_models_span_all_resonances_from_the_softest_to_a_stiffened_free_one(rig):
    models = bounding_models(rig.actuator, limits_of(rig), rig.amplifier.source_impedance_ohm)
    believed, *others = [model.resonance_hz / rig.actuator.resonance_hz for model in models]
    assert (believed, others) == (1.0, sorted(others))
    assert others[0] == pytest.approx(0.9 / math.sqrt(1.1))
    lightest = 0.9 * 0.57 / (0.57 + 0.9 * rig.actuator.moving_mass_kg)
    assert others[-1] == pytest.approx(1.1 * math.sqrt(1.375 / lightest))
    known = replace(limits_of(rig), deviation=0.0, lightest_frame_kg=math.inf, stiffness_rise=0.0)
    assert bounding_models(rig.actuator, known, 0.0) == [rig.actuator]
