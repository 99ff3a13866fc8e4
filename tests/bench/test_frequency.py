"""Frequency errors: the bound is the textbook's, and no form beats it."""

import numpy as np
import pytest

from tools.bench.sections import frequency_error
from tools.bench.sections.frequency_error import (
    RANGES_HZ,
    SAMPLERATES,
    bound_hz,
)
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


@pytest.mark.exhaustive
def test_no_form_beats_the_bound_where_noise_decides(section):
    for span in RANGES_HZ:
        found = values(section, f"48000 Hz, {span[0]:g} to {span[1]:g} Hz")
        assert min(found[LIVE], found[REFERENCE]) > 1.1


@pytest.mark.exhaustive
def test_the_live_form_keeps_the_limit_at_every_samplerate(section):
    asked = [row for row in section.rows if row.must]
    assert len(asked) == 2 * len(SAMPLERATES)
    assert all(row.met for row in asked)
