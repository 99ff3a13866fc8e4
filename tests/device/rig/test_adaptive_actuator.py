"""The choice between the rig's two models: its error, its cost in models, and its bytes."""

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
from device.rig import CONSUMER, PAPER
from device.rig.actuator import QUANTITIES
from device.rig.adaptive_actuator import MARGIN, AdaptiveActuator
from device.rig.thermal import Temperatures
from tests.device.rig.test_rig_models import FS, columns, errors, times_of, tones
from tools.bench.sections.model_selection import block_errors

EXHAUSTIVE = pytest.mark.exhaustive
assert PAPER.thermal
THERMAL = PAPER.thermal
MODELS = st.sampled_from(["linear", "nonlinear"])


def swell(duration_s=1.6):
    """Tones from a whisper to beyond Xmax and back."""
    times = times_of(FS, duration_s)
    shares = np.array([0, 0.3, 0.6, 0.75, 1]) * duration_s
    return np.interp(times, shares, [0.02, 0.4, 8.0, 0.05, 0.0]) * tones(1.0, times)


def moved_by(actuator, parts, names=QUANTITIES):
    """The motion by some parts of a signal, (names, frames)."""
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
    "duration_s", [5, pytest.param(15, marks=EXHAUSTIVE), pytest.param(40, marks=pytest.mark.soak)]
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
