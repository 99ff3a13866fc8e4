"""Simulated studies recover the true parameters, and find nothing where nothing differs."""

import numpy as np
import pytest

from audioflinger_hook.study.measure import estimate, p_value
from audioflinger_hook.study.people import People, power, simulated_study
from tests.support.studies import QUESTIONS, TRUTHS, changed, make_study, truth

STUDIES = 200
COVERED = 0.90, 0.99
BIAS = 0.2  # of the interval's length
CASES = [(name, "simultaneity") for name in QUESTIONS] + [("synchrony", "order")]


def covered(folder, paradigm, judgement, studies):
    """Return shares of intervals with the true value, and biases in lengths of the interval."""
    design = changed(make_study(folder, paradigm), paradigm, judgement=judgement)
    inside, values, lengths = [], [], []
    true = truth(design.questions[paradigm], People(design, TRUTHS, 1))
    for seed in range(studies):
        measured = simulated_study(People(design, TRUTHS, seed), paradigm, 20)
        found, lows, highs = estimate(measured, seed)
        inside.append((lows <= true) & (true <= highs))
        values.append(found - true)
        lengths.append(highs - lows)
    return np.mean(inside, axis=0), np.mean(values, axis=0) / np.mean(lengths, axis=0)


@pytest.mark.exhaustive
@pytest.mark.parametrize(("paradigm", "judgement"), CASES)
def test_intervals_cover_the_truth_in_90_to_99_percent_of_200_studies(
    tmp_path, paradigm, judgement
):
    shares, bias = covered(tmp_path, paradigm, judgement, STUDIES)
    print(paradigm, judgement, shares, bias)
    assert COVERED[0] <= shares.min()
    assert shares.max() <= COVERED[1]
    assert np.abs(bias).max() < BIAS


@pytest.mark.parametrize(("paradigm", "judgement"), CASES)
def test_a_few_studies_already_show_the_truth(tmp_path, paradigm, judgement):
    shares, bias = covered(tmp_path, paradigm, judgement, 3)
    assert shares.mean() >= 0.6  # of 3 studies with correlated intervals
    assert np.abs(bias).max() < 0.6


def false_positives(design, studies):
    found = []
    for seed in range(studies):
        people = People(design, {"preference": {"worth_spread": 0.4}}, 5_000 + seed)
        p = p_value(simulated_study(people, "preference", 20))
        assert p is not None
        found.append(p < 0.05)
    return np.mean(found)


@pytest.mark.exhaustive
def test_preference_finds_a_difference_in_3_to_7_percent_of_2000_studies_without_one(tmp_path):
    assert 0.03 <= false_positives(make_study(tmp_path, "preference"), 2_000) <= 0.07


def test_preference_seldom_finds_a_difference_where_there_is_none(tmp_path):
    assert false_positives(make_study(tmp_path, "preference"), 40) <= 0.15


def test_power_grows_with_the_effect(tmp_path, monkeypatch):
    monkeypatch.setattr("audioflinger_hook.study.people.STUDIES", 20)
    design = make_study(tmp_path, "preference", participants=12)
    powers = []
    for worth in (0.0, 0.5, 3.0):
        one = changed(design, "preference", effect={"worth": {"a": worth}})
        powers.append(power(one, "preference", lambda *_: None) or 0.0)
    assert powers[0] < 0.25
    assert powers[0] < powers[1] <= powers[2] == 1.0


def test_unanimous_participants_give_finite_estimates(tmp_path):
    design = make_study(tmp_path, "preference")
    people = People(design, {"preference": {"worth": {"a": 50, "b": 0, "c": -50}}}, 1)
    measured = simulated_study(people, "preference", 5)
    assert np.isfinite(estimate(measured, 1)).all()
    p = p_value(measured)
    assert p is not None
    assert p < 0.01


def test_one_participant_gives_values_without_intervals(tmp_path):
    measured = simulated_study(People(make_study(tmp_path, "rating"), {}, 1), "rating", 1)
    values, lows, _ = estimate(measured, 1)
    assert np.isfinite(values).all()
    assert np.isnan(lows).all()
    assert p_value(measured) is None
