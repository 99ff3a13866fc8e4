"""The choice between the rig's two models: its error, its cost in models, and its bytes."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, sosfilt

from device.errors import UsageError
from device.rig import CONSUMER, PAPER
from device.rig.adaptive_actuator import MARGIN, AdaptiveActuator
from device.rig.thermal import COPPER_PER_K, Temperatures
from tests.device.rig.test_rig_models import FS, columns, errors, times_of, tones
from tools.bench.sections.model_selection import block_errors

EXHAUSTIVE = pytest.mark.exhaustive
assert PAPER.thermal
THERMAL = PAPER.thermal


def swell(duration_s=1.6):
    """Tones from a whisper to beyond Xmax and back."""
    times = times_of(FS, duration_s)
    shares = np.array([0, 0.3, 0.6, 0.75, 1]) * duration_s
    return np.interp(times, shares, [0.02, 0.4, 8.0, 0.05, 0.0]) * tones(1.0, times)


def noise(level_v, duration_s, seed=1):
    return level_v * np.random.default_rng(seed).standard_normal(round(duration_s * FS))


def music(level_v, duration_s, seed=2):
    sections = butter(2, [20, 1_000], "band", fs=FS, output="sos")
    band = sosfilt(sections, noise(1.0, duration_s, seed))
    envelope = 0.3 + 0.7 * np.abs(np.sin(math.tau * 0.7 * times_of(FS, duration_s))) ** 3
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


@cache
def scenes(duration_s):
    # A quiet block after a loud one has the smaller peak, and what the loud one left behind.
    times = times_of(FS, 0.25)
    edge = np.minimum(1.0, np.minimum(times, times[::-1]) / 0.005)
    bursts = np.concatenate(
        [
            40.0 * 10.0 ** random.uniform(-3.0, 0.0) * edge
            * np.sin(math.tau * 20.0 * 11.0 ** random.random() * times)
            for random in map(np.random.default_rng, range(round(4 * duration_s)))
        ]
    )  # fmt: skip
    part = times_of(FS, duration_s / 5)
    squares = np.concatenate(
        [
            level_v * np.sign(np.sin(math.tau * hz * part + 1e-9))
            for level_v, hz in ((15, 90), (3, 40), (0.5, 33), (8, 60), (0.2, 120))
        ]
    )
    return {
        "bursts": bursts,
        "mostly silence": bursts * np.repeat(np.arange(4 * duration_s) % 5 == 0, FS // 4),
        "swell": np.resize(swell(), round(duration_s * FS)),
        "quiet music": music(1.0, duration_s),
        "loud music": music(20.0, duration_s),
        "tones": 3.0 * np.sin(math.tau * 46.6 * times_of(FS, duration_s)),
        "squares": squares,
        "noise": noise(20.0, duration_s),
        "faint noise": noise(0.3, duration_s),
        "game": game(22.0, duration_s),
    }


@cache
def truth(rig, scene, duration_s, seat=False):
    fine = AdaptiveActuator(rig, FS, model="nonlinear", refine=1, seat=seat)
    return fine.move(scenes(duration_s)[scene])


# In full: 10 scenes of 40 s at six tolerances, 4 000 blocks at each.
@pytest.mark.parametrize("duration_s", [5, pytest.param(40, marks=EXHAUSTIVE)])
@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=lambda rig: rig.name)
@pytest.mark.parametrize("scene", scenes(5))
def test_no_block_is_beyond_the_tolerance(scene, rig, duration_s):
    for tolerance in (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 1e-4):
        actuator = AdaptiveActuator(rig, FS, tolerance)
        motion = actuator.move(scenes(duration_s)[scene])
        wrong = block_errors(actuator.reports, motion, truth(rig, scene, duration_s), rig.actuator)
        assert len(wrong) >= 9 * duration_s
        assert wrong.max() <= tolerance
        assert max(block.estimate for block in actuator.reports) <= tolerance


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3])
def test_on_a_seat_no_block_is_beyond_the_tolerance_either(tolerance):
    actuator = AdaptiveActuator(PAPER, FS, tolerance, seat=True)
    motion = actuator.move(scenes(5)["swell"])
    wrong = block_errors(
        actuator.reports, motion, truth(PAPER, "swell", 5, seat=True), PAPER.actuator
    )
    assert wrong.max() <= tolerance
    assert min(actuator.frames_by_model.values()) > 0


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


def test_quiet_blocks_after_loud_ones_go_back_to_the_linear_model():
    times = times_of(FS, 3.0)
    volts = np.where(times < 1.5, 12.0, 0.05) * np.sin(math.tau * 70.0 * times)
    actuator = AdaptiveActuator(PAPER, FS, 1e-2)
    actuator.move(volts)
    assert {one.model for one in actuator.reports if one.frame < FS} == {"nonlinear"}
    assert {one.model for one in actuator.reports if one.frame > 1.8 * FS} == {"linear"}


@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=lambda rig: rig.name)
@pytest.mark.parametrize("tolerance", [3e-2, 1e-2, 3e-3])
def test_where_the_model_changes_the_motion_goes_on(rig, tolerance):
    times = times_of(FS, 1.6)
    envelope = 0.4 + 3.0 * np.sin(math.pi * times / 1.6) ** 2
    volts = envelope * (np.sin(math.tau * 46.6 * times) + np.sin(math.tau * 92.0 * times))
    actuator = AdaptiveActuator(rig, FS, tolerance)
    motion = actuator.move(volts)
    models = [report.model for report in actuator.reports]
    changes = [
        report.frame
        for before, report in zip(models, list(actuator.reports)[1:], strict=False)
        if report.model != before
    ]
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
@given(
    st.lists(st.integers(0, 9_600), max_size=9),
    st.sampled_from(["linear", "nonlinear"]),
    st.booleans(),
)
def test_one_model_gives_the_same_bytes_however_the_signal_is_split(cuts, model, seat):
    volts, names = tones(6.0, times_of(FS, 0.2)), ("displacement_m", "acceleration_m_s2")
    whole = columns(AdaptiveActuator(PAPER, FS, model=model, seat=seat).move(volts), names)
    actuator = AdaptiveActuator(PAPER, FS, model=model, seat=seat)
    parts = [columns(actuator.move(part), names) for part in np.split(volts, sorted(cuts))]
    assert np.concatenate(parts, axis=1).tobytes() == whole.tobytes()
    assert columns(actuator.move(np.zeros(0)), names).shape == (2, 0)


def test_the_choice_gives_the_same_bytes_for_parts_that_end_with_a_block():
    actuator = AdaptiveActuator(PAPER, FS, 1e-2)
    whole = columns(actuator.move(swell()))
    actuator.reset()
    parts = np.split(swell(), range(actuator.block_frames, len(swell()), 3 * actuator.block_frames))
    assert np.array_equal(np.concatenate([columns(actuator.move(p)) for p in parts], 1), whole)


@pytest.mark.parametrize("frames", [1, 7, 100])
def test_the_tolerance_holds_in_parts_of_any_length(frames):
    volts = swell(0.4)
    true = AdaptiveActuator(PAPER, FS, model="nonlinear", refine=1).move(volts)
    actuator = AdaptiveActuator(PAPER, FS, 1e-2)
    parts = np.split(volts, range(frames, len(volts), frames))
    got = np.concatenate([columns(actuator.move(part)) for part in parts], axis=1)
    # Such a part has no peak of its own; that of the signal is larger.
    assert errors(got[[0, 3]], columns(true)[[0, 3]]).max() < 1e-2
    assert min(actuator.frames_by_model.values()) > 0


def test_after_reset_the_actuator_is_as_new():
    actuator = AdaptiveActuator(PAPER, FS, 1e-2)
    first = columns(actuator.move(swell(0.3)))
    actuator.reset()
    assert (len(actuator.reports), sum(actuator.frames_by_model.values())) == (0, 0)
    assert np.array_equal(columns(actuator.move(swell(0.3))), first)


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


# ----------------------------------------------------------------------------------- temperature


def test_a_steady_power_warms_coil_and_magnet_by_their_thermal_resistances():
    warm = Temperatures(THERMAL)
    assert warm.resistance_ohm(3.3) == 3.3
    for _ in range(400):
        warm.heat(10.0, 60.0)
    assert warm.magnet_k == pytest.approx(10.0 * 3.0, rel=1e-6)
    assert warm.coil_k == pytest.approx(10.0 * (4.0 + 3.0), rel=1e-6)
    hot = warm.resistance_ohm(3.3)
    assert hot == pytest.approx(3.3 * (1 + COPPER_PER_K * 70.0))


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
