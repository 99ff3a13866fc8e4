"""The comparison: its measures find what was put in, and its verdict is computed from its rows."""

import math

import numpy as np
import pytest

from tools.bench.baselines import BASELINES
from tools.bench.measures import similarity
from tools.bench.report import Row
from tools.bench.sections import comparison
from tools.bench.sounds.signals import SAMPLERATE, Recording, tone, white_noise
from tools.bench.workbench import LIVE, QUICK, REFERENCE, SUBJECTS, Workbench


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
