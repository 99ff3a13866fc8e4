"""Order and sides of trials are balanced exactly, in each participant's session."""

from collections import Counter
from typing import Any

import pytest

from audioflinger_hook.study.session import session
from tests.support.studies import QUESTIONS, changed, make_study


def conditions(row):
    return tuple(row[key] for key in ("condition_1", "condition_2") if key in row)


@pytest.mark.parametrize("participant", range(4))
@pytest.mark.parametrize("repeats", [2, 4, 6, 10])
@pytest.mark.parametrize("paradigm", ["preference", "synchrony", "threshold", "equal"])
def test_each_condition_is_first_in_half_and_each_answer_left_in_half_of_the_trials(
    tmp_path, paradigm, repeats, participant
):
    design = changed(make_study(tmp_path, paradigm), paradigm, repeats=repeats)
    question = design.questions[paradigm]
    trials = session(design, participant)
    kinds: dict[object, list[dict[str, Any]]] = {}
    for row in trials:
        if not row["practice"]:
            key = row["stimulus"], frozenset(conditions(row)), row["varied"]
            kinds.setdefault(key, []).append(row)
    assert len(kinds) == len(question.pairs) * 2 * len(question.delays)
    for of_kind in kinds.values():
        assert len(of_kind) == repeats
        left = Counter(row["choices"][0] for row in of_kind)
        assert list(left.values()) == [repeats / 2] * 2
        if len(conditions(of_kind[0])) == 2:
            first = Counter(row["condition_1"] for row in of_kind)
            assert list(first.values()) == [repeats / 2] * 2
            if repeats % 4 == 0:
                both = Counter((row["condition_1"], row["choices"][0]) for row in of_kind)
                assert list(both.values()) == [repeats / 4] * 4


def test_sessions_differ_between_participants_and_are_the_same_each_time(tmp_path):
    design = make_study(tmp_path, *QUESTIONS)
    sessions = [session(design, participant) for participant in (0, 1, 6, 0)]
    assert sessions[0] == sessions[3]
    orders = [[(r["question"], r["stimulus"], conditions(r)) for r in one] for one in sessions[:3]]
    assert orders[0] != orders[1]
    assert orders[0] != orders[2]
    assert [row["trial"] for row in sessions[1]] == list(range(1, len(sessions[1]) + 1))
    first = [session(design, k)[0]["question"] for k in range(len(QUESTIONS))]
    assert sorted(first) == sorted(QUESTIONS)  # each question comes first equally often


def test_ratings_hide_the_reference_and_the_anchor_among_the_conditions(tmp_path):
    trials = session(make_study(tmp_path, "rating", more="practice = 0"), 0)
    assert Counter(map(conditions, trials)) == {("a", name): 4 for name in "abc"}
