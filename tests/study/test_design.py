"""A design is checked before the first participant: every mistake is told, all at once."""

import numpy as np
import pytest
import soundfile

from audioflinger_hook.study.design import MistakesError, load
from tests.support.commands import call
from tests.support.data import table
from tests.support.studies import QUESTIONS, make_study

MISTAKES = table("design-mistakes.toml")["mistakes"]


def changed(tmp_path, *pairs, paradigms=("preference",)):
    """Return the mistakes of a design in which texts are replaced."""
    make_study(tmp_path, *paradigms)
    text = (tmp_path / "design.toml").read_text()
    for old, new in pairs:
        text = text.replace(old, new, 1)
    (tmp_path / "design.toml").write_text(text)
    try:
        load(tmp_path)
    except MistakesError as error:
        return [(one.key, str(one)) for one in error.args]
    return []


@pytest.mark.parametrize(("old", "new", "key", "words"), MISTAKES)
def test_a_mistake_is_told_with_its_key(tmp_path, old, new, key, words):
    found = changed(tmp_path, (old, new))
    assert any(told == key and words in text for told, text in found), found


def test_each_paradigm_has_a_design_without_mistakes(tmp_path):
    assert changed(tmp_path, paradigms=list(QUESTIONS)) == []


def test_all_mistakes_are_told_at_once_and_the_exit_code_is_2(tmp_path):
    pairs = [
        ('paradigm = "preference"', 'paradigm = "no"'),
        ('["x.wav", "y.wav"]', '["gone.wav"]'),
        ("repeats = 2", "repeats = 0"),
        ('name = "b"', 'name = "a"'),
        ("repeats = 6", "repeats = 1000\nreferense = 1"),
        ("level_db = -40", "level_db = -40\nanswer_s = 60.0"),
    ]
    told = changed(tmp_path, *pairs, paradigms=("preference", "synchrony"))
    keys = {key for key, _ in told}
    assert keys >= {
        *(
            "question[1].paradigm",
            "question[1].stimuli",
            "question[1].repeats",
            "condition[2].name",
        ),
        *("question[2].referense", "this study"),
    }
    done = call("study", "check", tmp_path)
    assert (done.code, len(done.stderr.splitlines())) == (2, len(told))


def test_a_study_of_more_than_8_hours_is_refused(tmp_path):
    slow = ("level_db = -40", "level_db = -40\nanswer_s = 9.0")
    found = changed(tmp_path, ("repeats = 2", "repeats = 1000"), slow)
    assert [key for key, _ in found] == ["this study"]
    assert "at most 8 h" in found[0][1]


def test_a_condition_that_gives_no_vibration_for_a_sound_is_told(tmp_path):
    changed(tmp_path, ('"x.wav"', '"low.wav"'))
    soundfile.write(tmp_path / "low.wav", np.sin(np.arange(9_600) * 0.013), 48_000)
    silent = call("study", "check", tmp_path, "--no-power")
    assert silent.code == 2
    assert "gives no vibration" in silent.stderr
