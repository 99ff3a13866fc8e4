"""Frequency errors: the bound is the textbook's, no form beats it, and what merges is named."""

import numpy as np
import pytest

from tools.bench.sections import frequency_error
from tools.bench.sections.frequency_error import (
    RANGES_HZ,
    bound_hz,
    window_loss,
)
from tools.bench.sections.tones import SAMPLERATES
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import LIVE, QUICK, REFERENCE, SUBJECTS, Workbench


@pytest.fixture(scope="module")
def section():
    return frequency_error.frequency_error(Workbench(QUICK, SUBJECTS, ()))


def values(section, name):
    return {row.column: row.value for row in section.rows if row.name == name}


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


def test_twenty_decibels_less_noise_are_a_tenth_of_the_bound():
    assert bound_hz(48_000, 2_229, 20.0) == pytest.approx(0.1 * bound_hz(48_000, 2_229, 0.0))


def test_through_a_window_the_error_is_that_of_the_weighted_fit():
    assert 1.2 < window_loss() < 1.4


@pytest.mark.exhaustive
def test_no_form_beats_the_bound_where_noise_decides(section):
    for span in RANGES_HZ:
        found = values(section, f"{span[0]:g} to {span[1]:g} Hz, 0 dB")
        assert min(found[LIVE], found[REFERENCE]) > 1.1


def test_the_live_form_keeps_the_limit_at_every_samplerate(section):
    asked = [row for row in section.rows if row.must]
    assert len(asked) == 2 * len(SAMPLERATES)
    assert all(row.met for row in asked)


def test_what_the_reference_form_is_off_without_noise_is_the_pull_of_the_image(section):
    low, middle, high = (
        values(section, f"{SAMPLERATE} Hz, {span[0]:g} to {span[1]:g} Hz") for span in RANGES_HZ
    )
    with_image = f"{REFERENCE}, no noise"
    without = f"{REFERENCE}, no noise, no image"
    assert low[with_image] > 10.0 * low[without]
    assert middle[with_image] > 3.0 * middle[without]
    # the bias of the parabola is the same everywhere
    assert low[without] == pytest.approx(high[without], rel=0.2)
    # and the live form, which takes the image away, is as good as if there were none
    assert low[f"{LIVE}, no noise"] < 1.2 * low[without]


def test_two_tones_are_found_as_two_from_45_hz_apart_and_what_merges_is_named(section):
    for form in (LIVE, REFERENCE):
        assert values(section, "two tones 90 Hz apart, two found")[form] == 100.0
        assert values(section, "two tones 45 Hz apart, two found")[form] > 95.0
        assert values(section, "two tones 30 Hz apart, two found")[form] < 95.0
    assert "some merge 30 Hz apart" in section.explanation
