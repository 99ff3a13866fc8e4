"""Single sections: bounds and growth, and measures on sounds and motions that are known."""

from dataclasses import replace

import numpy as np
import pytest

from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.transform import TransformParameters
from device.rig import PAPER
from device.rig.adaptive_actuator import AdaptiveActuator, BlockReport
from tests.support.signals import joined, tone
from tools.bench.sections import frequency_error, scaling
from tools.bench.sections.frequency_error import RANGES_HZ, SAMPLERATES, bound_hz
from tools.bench.sections.model_selection import block_errors
from tools.bench.sections.profiles import Way, loudest_db, units_db
from tools.bench.sounds.signals import SAMPLERATE
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
    sound = tone(1_000, 1.0, SAMPLERATE)
    assert units_db(sound) == pytest.approx(np.zeros(21), abs=0.05)
    assert loudest_db(sound) == pytest.approx(0.0, abs=0.05)
    sound = joined(tone(300, 9.0, SAMPLERATE, 0.01), tone(300, 1.0, SAMPLERATE, 0.5))
    assert loudest_db(sound) == pytest.approx(-6.0, abs=0.2)


def test_a_settled_sound_has_its_own_length_and_knows_what_was_played_before():
    sound, cinema = tone(440, 0.7, SAMPLERATE, 0.05), Way("cinema", parameters_of("cinema"))
    fresh, settled = cinema.settled(sound, 0.0), cinema.settled(sound, 8.0)
    assert fresh.size == settled.size == sound.size
    # The programme's level has moved, and a sound that goes on has no onset.
    assert settled.tobytes() != fresh.tobytes()
    paper = Way("paper", TransformParameters())
    assert paper.settled(sound, 8.0).tobytes() == paper.felt(sound)[: sound.size].tobytes()
