import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design import synthesis
from audioflinger_hook.transform.design.synthesis import LiveGrid
from device.drive.damping import choose_damping, undamped
from device.errors import UsageError
from device.rig import CONSUMER, PAPER
from device.rig.actuator import LinearActuator
from device.rig.adaptive_actuator import AdaptiveActuator, BlockReport
from tests.support import signals
from tools.bench.baselines import BASELINES
from tools.bench.measures import similarity
from tools.bench.measures.flat_inverse import FlatInverse
from tools.bench.measures.large_bursts import large_burst_response, undamped_large
from tools.bench.report import Row
from tools.bench.sections import comparison, frequency_error, frontier, scaling
from tools.bench.sections.frequency_error import RANGES_HZ, SAMPLERATES, bound_hz
from tools.bench.sections.frontier import COST, LAG, LEAK
from tools.bench.sections.frontier_settings import DEFAULT, SETTINGS, Setup, constants_changed, hop
from tools.bench.sections.model_selection import block_errors
from tools.bench.sections.profiles import Way, loudest_db, units_db
from tools.bench.sounds.signals import SAMPLERATE, Recording, tone, white_noise
from tools.bench.workbench import LIVE, QUICK, REFERENCE, SUBJECTS, Workbench


def test_the_bound_is_what_the_information_in_the_samples_says():
    # Fisher information of frequency, phase and amplitude, summed over the samples themselves.
    rate, frames, snr_db, audio_hz = 48_000, 2_229, 20.0, 1_000.0
    turns = 2.0 * np.pi * np.arange(frames) / rate
    phase = turns * audio_hz + 0.3
    slopes = np.stack((-turns * np.sin(phase), -np.sin(phase), np.cos(phase)))
    deviation = np.sqrt(0.5 * 10.0 ** (-snr_db / 10.0))
    variance = np.linalg.inv(slopes @ slopes.T / deviation**2)[0, 0]
    # of many cycles: the textbook leaves out what oscillates at twice the frequency
    assert bound_hz(rate, frames, snr_db) == pytest.approx(np.sqrt(variance), rel=0.01)
    assert bound_hz(rate, frames, 20.0) == pytest.approx(0.1 * bound_hz(rate, frames, 0.0))


@pytest.mark.exhaustive
def test_no_form_beats_the_bound_and_the_live_form_keeps_the_limit_at_every_samplerate():
    section = frequency_error.frequency_error(Workbench(QUICK, SUBJECTS, ()))
    spans = {f"48000 Hz, {low:g} to {high:g} Hz" for low, high in RANGES_HZ}
    decided = [row for row in section.rows if row.name in spans and row.column in (LIVE, REFERENCE)]
    assert len(decided) == 2 * len(spans)
    assert min(row.value or 0.0 for row in decided) > 1.1  # noise decides there
    asked = [row for row in section.rows if row.must]
    assert len(asked) == 2 * len(SAMPLERATES)
    assert all(row.met for row in asked)


@pytest.mark.exhaustive
def test_growth_is_told_as_ratios_of_one_run_with_an_exponent_each():
    section = scaling.rig_scaling(Workbench(replace(QUICK, rig_s=1.0), SUBJECTS, ()))
    columns = {row.column for row in section.rows}
    assert len(columns) == 3
    for column in columns:
        rows = {row.name: row for row in section.rows if row.column == column}
        assert rows["sample rate: 48 kHz"].value == 1.0
        assert rows["number of actuators: 1, each"].value == 1.0
        limited = {name for name, row in rows.items() if row.must}
        assert limited == {"duration: exponent", "number of actuators: exponent"}


def test_a_blocks_error_is_the_larger_one_over_its_own_peak():
    times = np.arange(96_000) / 48_000
    volts = 5.0 * np.sin(np.pi * times) ** 2 * np.sin(2 * np.pi * 70.0 * times)
    true = AdaptiveActuator(PAPER, 48_000, model="linear").move(volts)
    blocks = [BlockReport(frame, 4_800, "linear", 0.0) for frame in range(0, len(volts), 4_800)]
    moved = true._replace(displacement_m=true.displacement_m.copy())
    moved.displacement_m[70_000] += 0.02 * np.abs(true.displacement_m[67_200:72_000]).max()
    errors = block_errors(blocks, moved, true, PAPER.actuator)
    assert errors[14] == pytest.approx(0.02)
    assert np.count_nonzero(errors) == 1


def test_a_full_scale_tone_has_every_level_at_0_db_and_the_loudest_tenth_is_a_short_loud_part_s():
    sound = signals.tone(1_000, 1.0, SAMPLERATE)
    assert units_db(sound) == pytest.approx(np.zeros(21), abs=0.05)
    assert loudest_db(sound) == pytest.approx(0.0, abs=0.05)
    sound = signals.joined(
        signals.tone(300, 9.0, SAMPLERATE, 0.01), signals.tone(300, 1.0, SAMPLERATE, 0.5)
    )
    assert loudest_db(sound) == pytest.approx(-6.0, abs=0.2)


def test_a_settled_sound_has_its_own_length_and_knows_what_was_played_before():
    sound, cinema = signals.tone(440, 0.7, SAMPLERATE, 0.05), Way("cinema", parameters_of("cinema"))
    fresh, settled = cinema.settled(sound, 0.0), cinema.settled(sound, 8.0)
    assert fresh.size == settled.size == sound.size
    # The programme's level has moved, and a sound that goes on has no onset.
    assert settled.tobytes() != fresh.tobytes()
    paper = Way("paper", TransformParameters())
    assert paper.settled(sound, 8.0).tobytes() == paper.felt(sound)[: sound.size].tobytes()


def gated(frequency_hz, period_s=0.5, duration_s=3.0):
    time_s = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    return tone(frequency_hz, 0.3, duration_s) * (time_s % period_s < 0.5 * period_s)


def test_an_envelope_that_comes_later_is_the_same_and_a_steady_one_has_nothing_of_it():
    def correlation(vibration):
        return similarity.envelope_correlation(gated(1_000.0), vibration, SAMPLERATE)

    assert correlation(np.roll(gated(100.0), round(0.04 * SAMPLERATE))) > 0.98
    assert abs(correlation(tone(100.0, 0.3, 3.0))) < 0.1
    assert correlation(np.zeros(3 * SAMPLERATE)) == 0.0


def test_the_felt_spectrum_has_the_level_of_a_tone_and_tones_apart_share_nothing():
    _, power = similarity.felt_spectrum(tone(100.0, 0.5, 1.0) + tone(1_000.0, 0.5, 1.0), SAMPLERATE)
    assert similarity.level_db(power.sum()) == pytest.approx(20.0 * math.log10(0.5), abs=0.05)
    low, high, heard = (tone(hz, 0.3, 1.0) for hz in (100.0, 180.0, 1_000.0))
    assert similarity.spectral_distance(low, high, SAMPLERATE) == pytest.approx(1.0, abs=0.01)
    assert similarity.spectral_distance(low, 0.1 * low, SAMPLERATE) == pytest.approx(0.0, abs=1e-9)
    assert similarity.spectral_distance(low, heard, SAMPLERATE) is None


def test_a_baseline_wins_exactly_where_its_row_is_better():
    rows = [
        Row(comparison.COST, 2.0, "ms", LIVE),
        Row(comparison.COST, 1.0, "ms", "band-pass"),
        Row(comparison.COST, 3.0, "ms", "centroid"),
        Row(comparison.CORRELATION, 0.5, "", LIVE),
        Row(comparison.CORRELATION, 0.4, "", "band-pass"),
        Row(comparison.LAG_P95, 9.0, "ms", LIVE),
        Row(comparison.LAG_P95, None, "ms", "band-pass", note="none perceived"),
    ]
    verdict = comparison.where_baselines_win(rows)
    assert verdict.startswith("Rows in which a baseline beats the live form:\n")
    assert f"- {comparison.COST} (band-pass 1 against 2 ms)" in verdict
    assert "centroid" not in verdict
    assert comparison.CORRELATION not in verdict
    assert comparison.LAG_P95 not in verdict
    dearer = [row for row in rows if row.column != "band-pass"]
    assert "No baseline" in comparison.where_baselines_win(dearer)


def test_every_way_has_a_value_or_a_reason_in_every_row_and_high_tones_stay_two():
    recordings = (Recording("noise", "made", white_noise(1.0), SAMPLERATE),)
    section = comparison.compared(Workbench(QUICK, SUBJECTS, recordings))
    by_place = {(row.name, row.column): row for row in section.rows}
    for name in {row.name for row in section.rows}:
        for column in (LIVE, REFERENCE, *(each.name for each in BASELINES)):
            row = by_place[name, column]
            assert row.value is not None or row.note
    assert set(comparison.CRITERIA) <= {name for name, _ in by_place}
    # In the live form; a band-pass leaves nothing of them.
    assert (by_place[comparison.DISTANCE, LIVE].value or 0.0) > 0.9
    assert by_place[comparison.DISTANCE, "band-pass"].value is None


CONSTANTS = ("HOPS_A_WINDOW", "LOW_RATE_HZ", "LOW_PASS")


def numbers():
    return [getattr(synthesis, name) for name in CONSTANTS]


def test_the_default_is_the_live_form_to_the_byte():
    sound = tone(440.0, 0.3, 0.3)
    (live,) = (subject for subject in SUBJECTS if subject.name == LIVE)
    ours = Setup(SETTINGS[0]).vibration(sound)
    assert SETTINGS[0].name == DEFAULT
    assert ours.tobytes() == live.vibration(sound, SAMPLERATE).tobytes()


@pytest.mark.parametrize("setting", SETTINGS[1:], ids=lambda setting: setting.name)
def test_every_setting_changes_the_form_and_leaves_the_transform_as_it_was(setting):
    before = numbers()
    form, plain = Setup(setting).made, Setup(SETTINGS[0]).made
    assert numbers() == before
    assert form != plain
    # Also where a transform cannot be made.
    with pytest.raises(ZeroDivisionError), constants_changed({"LOW_PASS": None}):
        _ = 1 / 0
    assert numbers() == before


def test_with_a_shorter_hop_a_chirp_is_followed_nearer_and_without_onsets_less_lag():
    slow, fast = (Setup(hop(hops)) for hops in (1.0, 8.0))
    grids = [setup.made.grid for setup in (slow, fast)]
    assert isinstance(grids[0], LiveGrid)
    assert grids[0].hop_frames > 7 * grids[1].hop_frames
    without = [Setup(replace(hop(hops), name="without", onsets=False)) for hops in (1.0, 8.0)]
    assert frontier._lag_p95_ms(without[1], 2) < frontier._lag_p95_ms(without[0], 2) - 10.0
    # Onsets wait for no hop.
    assert frontier._lag_p95_ms(slow, 2) < frontier._lag_p95_ms(without[1], 2) - 10.0
    assert frontier._chirp_error_hz(fast) < 0.5 * frontier._chirp_error_hz(slow)


def test_partials_that_there_is_no_room_for_are_missed_and_none_is_spurious():
    (few,) = (setting for setting in SETTINGS if setting.name == "4 partials")
    missed, spurious = frontier._notes(Setup(few))
    assert missed == pytest.approx(100.0 * (1.0 - 4 / frontier.HARMONICS))
    assert spurious == 0.0
    assert frontier._notes(Setup(SETTINGS[0])) == (0.0, 0.0)


def test_a_setting_dominates_only_if_it_is_better_in_something_and_worse_in_nothing():
    default = dict.fromkeys(frontier.UNITS, 1.0)
    cheaper = default | {COST: 0.5}
    others = {"traded": cheaper | {LAG: 3.0}, "blurred": default | {COST: 0.95, LEAK: 1.2}}
    verdict = frontier._verdict({DEFAULT: default} | others)
    assert "The defaults lie on the frontier: no other setting" in verdict
    assert "- traded: better in cost 0.500 ms; worse in lag, p95 3 ms" in verdict
    assert "- blurred: better in nothing; worse in nothing" in verdict
    verdict = frontier._verdict({DEFAULT: default, "cheaper": cheaper} | others)
    assert "worse in no column: cheaper." in verdict


RATE = 48_000
X_MAX = PAPER.actuator.x_max_m
CHOSEN = choose_damping(PAPER.actuator)[0].damping


def scaled(rig, signal, level):
    """The signal in V with which the linear rig swings to a share of Xmax, and that motion."""
    source = rig.amplifier.source_impedance_ohm
    largest = np.abs(LinearActuator(rig.actuator, RATE, source).move(signal).displacement_m).max()
    volts = signal * (level * rig.actuator.x_max_m / largest)
    return volts, LinearActuator(rig.actuator, RATE, source).move(volts)


def bumps(frequencies_hz, seconds=0.2):
    time_s = np.arange(round(seconds * RATE)) / RATE
    envelope = np.sin(np.pi * time_s / seconds) ** 2
    return envelope * sum(np.sin(math.tau * f * time_s) for f in frequencies_hz)


def error(got, wanted):
    return np.sqrt(np.mean((got - wanted) ** 2) / np.mean(wanted**2))


@settings(max_examples=25)
@given(
    st.lists(st.floats(0.2, 1.4), min_size=1, max_size=4),
    st.floats(0.01, 1.1),
    st.sampled_from([PAPER, CONSUMER]),
)
def test_the_rig_moves_as_the_linear_one_with_any_tones_to_beyond_xmax(ratios, level, rig):
    # Far above its resonance it would take hundreds of volts, and the motion would not be stable.
    volts, wanted = scaled(rig, bumps([r * rig.actuator.resonance_hz for r in ratios]), level)
    got = AdaptiveActuator(rig, RATE, model="nonlinear").move(FlatInverse(rig, RATE).process(volts))
    # Between samples the voltage is a straight line, and the level's nodes are at 6 kHz: 1e-4.
    assert error(got.acceleration_m_s2, wanted.acceleration_m_s2) < 1e-3
    assert error(got.displacement_m, wanted.displacement_m) < 1e-3


def test_the_third_harmonic_of_a_low_tone_is_gone_and_without_it_the_rig_moves_otherwise():
    volts, _ = scaled(PAPER, bumps([30.0], 0.5), 0.9)
    shown = []
    for drive in (volts, FlatInverse(PAPER, RATE).process(volts)):
        a = AdaptiveActuator(PAPER, RATE, model="nonlinear").move(drive).acceleration_m_s2
        spectrum = np.abs(np.fft.rfft(a * np.hanning(len(a))))
        shown.append(spectrum[45] / spectrum[15])  # bins of 2 Hz: 90 and 30 Hz
    assert shown[0] > 0.05
    assert shown[1] < 1e-3
    volts, wanted = scaled(PAPER, bumps([90.0]), 1.0)
    got = AdaptiveActuator(PAPER, RATE, model="nonlinear").move(volts)
    assert error(got.acceleration_m_s2, wanted.acceleration_m_s2) > 0.3


def against_undamped(level, flat, detuning=0.0):
    """A damped burst at a share of Xmax against an undamped one."""
    burst = large_burst_response(PAPER, CHOSEN, level * X_MAX, flat=flat, detuning=detuning)
    return burst.response.against(undamped_large(PAPER, level * X_MAX, detuning=detuning).response)


# At Xmax damping alone does not hold: -10.5 dB.
@pytest.mark.parametrize(
    ("level", "flat"), [(0.05, False), (0.05, True), (0.1, False), (0.1, True), (1.0, True)]
)
def test_damping_holds_its_limits_at_a_low_level_and_with_the_inverse_at_xmax(level, flat):
    low = (
        undamped(PAPER.actuator) if level == 1.0 else undamped_large(PAPER, level * X_MAX).response
    )
    burst = large_burst_response(PAPER, CHOSEN, level * X_MAX, flat=flat).response
    assert burst.against(low).residual_db <= -11.0
    for detuning in (-0.1, 0.1):
        assert against_undamped(level, flat, detuning).residual_db <= -7.0
    volts_db = against_undamped(level, flat).peak_volts_db
    if level < 1.0:
        assert volts_db <= 5.0
    else:
        assert 5.0 < volts_db < 11.0
        alone = large_burst_response(PAPER, CHOSEN, X_MAX, flat=False).response
        assert alone.against(low).residual_db > -10.5


@settings(max_examples=20)
@given(st.lists(st.integers(0, 4_000), max_size=8))
def test_any_split_gives_the_same_bytes_and_reset_begins_anew(cuts):
    volts, _ = scaled(PAPER, bumps([90.0], 0.1), 1.0)
    inverse = FlatInverse(PAPER, RATE)
    whole = inverse.process(volts)
    inverse.reset()
    parts = [inverse.process(part) for part in np.split(volts, sorted(cuts))]
    assert np.concatenate(parts).tobytes() == whole.tobytes()
    small = 1e-6 * volts  # is left alone
    inverse.reset()
    np.testing.assert_allclose(inverse.process(small), small, atol=1e-6 * np.abs(small).max())


@settings(max_examples=40)
@given(st.lists(st.floats() | st.sampled_from([1e4, -1e6, math.nan]), max_size=300))
def test_what_comes_out_is_finite_whatever_goes_in(volts):
    for rig in (PAPER, CONSUMER):
        assert np.isfinite(FlatInverse(rig, RATE).process(np.array(volts))).all()


def test_what_lies_beyond_the_stops_is_counted_and_a_rig_without_stiffening_is_refused():
    inverse = FlatInverse(PAPER, RATE)
    inverse.process(scaled(PAPER, bumps([90.0]), 1.0)[0])
    assert inverse.beyond_samples == 0
    inverse.process(scaled(PAPER, bumps([90.0]), 2.0)[0])
    assert inverse.beyond_samples > 0
    inverse.reset()
    assert inverse.beyond_samples == 0
    with pytest.raises(UsageError, match="large_signal"):
        FlatInverse(replace(PAPER, large_signal=None), RATE)
