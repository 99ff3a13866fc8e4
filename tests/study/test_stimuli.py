"""Mistakes of a design are all told at once; all conditions of a trial are equally strong."""

from hashlib import sha256

import numpy as np
import pytest
import soundfile
from scipy.signal import sosfilt

from audioflinger_hook.study.design import MistakesError, load
from audioflinger_hook.study.stimuli import Stimuli
from device.drive.exposure import wk_sections
from device.errors import UsageError
from tests.support.commands import call
from tests.support.data import table
from tests.support.studies import QUESTIONS, make_study

MATCHED_DB = 0.5


def weighted_db(vibration):
    return 10 * np.log10(np.sum(sosfilt(wk_sections(48_000), vibration[:, 0]) ** 2))


def made(stimuli, question, *conditions, stimulus="x.wav", varied=0.0):
    """Return what the first interval of a trial plays, in which the first condition is tested."""
    row = {"question": question, "stimulus": stimulus, "varied": varied, "tested": conditions[0]}
    return stimuli.of(row | {f"condition_{i}": name for i, name in enumerate(conditions, 1)})[0]


@pytest.mark.parametrize("level_db", [-50, -30])
def test_all_conditions_of_a_trial_have_the_same_weighted_level(tmp_path, level_db):
    more = '[[condition]]\nname = "d"\nmethod = "cinema"\ndelay_ms = 40'
    design = make_study(tmp_path, "preference")
    text = (
        (tmp_path / "design.toml").read_text().replace("level_db = -40", f"level_db = {level_db}")
    )
    text = text.replace('["a", "b", "c"]', '["a", "b", "c", "d"]') + more
    (tmp_path / "design.toml").write_text(text)
    stimuli = Stimuli(load(tmp_path))
    found = [made(stimuli, "preference", name, "a") for name in "abcd"]
    levels = [weighted_db(one.vibration) for one in found]
    assert max(levels) - min(levels) < MATCHED_DB
    assert max(np.abs(one.vibration).max() for one in found) <= 1.0
    assert [one.columns["weighted_db"] for one in found] == pytest.approx(
        [level_db] * 4, abs=MATCHED_DB
    )
    assert found[0].columns["vibration_sha256"] == sha256(found[0].vibration.tobytes()).hexdigest()
    assert len({one.columns["vibration_sha256"] for one in found}) == 4
    assert design.digest != stimuli.design.digest


def test_a_level_that_exceeds_full_scale_is_refused(tmp_path):
    make_study(tmp_path, "preference")
    text = (tmp_path / "design.toml").read_text()
    (tmp_path / "design.toml").write_text(text.replace("level_db = -40", "level_db = 0"))
    with pytest.raises(UsageError, match="exceeds full scale by"):
        Stimuli(load(tmp_path))


def test_an_offset_delays_the_vibration_by_exactly_that_time(tmp_path):
    stimuli = Stimuli(make_study(tmp_path, "synchrony"))
    found = {ms: made(stimuli, "synchrony", "a", varied=ms) for ms in (-200.0, 0.0, 120.0)}
    for ms, one in found.items():
        delayed = np.roll(found[0.0].vibration, round(48 * ms), axis=0)
        assert np.array_equal(delayed, one.vibration)
    assert len(found[0.0].sound) == len(found[0.0].vibration)


def test_adaptive_levels_and_silence_are_what_they_say(tmp_path):
    stimuli = Stimuli(make_study(tmp_path, "threshold"))
    assert made(stimuli, "threshold", "a", "none", varied=-12.0).columns[
        "weighted_db"
    ] == pytest.approx(-52.0, abs=0.1)
    row = {"question": "threshold", "stimulus": "x.wav", "varied": -12.0, "tested": "a"}
    silent = stimuli.of(row | {"condition_1": "none", "condition_2": "a"})[0]
    assert silent.columns["weighted_db"] is None
    assert not silent.vibration.any()


def test_a_vibration_may_be_a_file_of_the_sounds_length(tmp_path):
    make_study(tmp_path, "preference")
    text = (tmp_path / "design.toml").read_text()
    (tmp_path / "design.toml").write_text(text.replace('"envelope"', '"v-{stimulus}.wav"'))
    for name, frames in (("x", 9_600), ("y", 9_600)):
        soundfile.write(tmp_path / f"v-{name}.wav", np.sin(np.arange(frames) / 90), 48_000)
    one = made(Stimuli(load(tmp_path)), "preference", "b", "a")
    assert one.columns["weighted_db"] == pytest.approx(-40, abs=0.01)
    soundfile.write(tmp_path / "v-y.wav", np.sin(np.arange(5_000) / 90), 48_000)
    with pytest.raises(UsageError, match="make both equal"):
        Stimuli(load(tmp_path))


def test_masking_noise_is_heard_at_its_level_and_not_felt(tmp_path):
    quiet = made(Stimuli(make_study(tmp_path, "preference")), "preference", "a", "b")
    stimuli = Stimuli(make_study(tmp_path, "preference", more="masking_db = -30"))
    masked = made(stimuli, "preference", "a", "b")
    noise = masked.sound - quiet.sound
    assert 10 * np.log10(np.mean(noise**2)) == pytest.approx(-30, abs=0.1)
    assert np.array_equal(masked.vibration, quiet.vibration)


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


def test_only_a_later_name_is_a_duplicate(tmp_path):
    found = changed(tmp_path, ('name = "b"', 'name = "a"'))
    assert [key for key, text in found if "duplicate" in text] == ["condition[2].name"]


@pytest.mark.parametrize("paradigm", ["synchrony", "threshold", "equal"])
@pytest.mark.parametrize(
    "pairs",
    [
        [('method = "band-pass"', 'method = "none"')],  # a condition without vibration
        [('name = "a"', 'name = "none"'), ('["a"', '["none"')],  # as the other interval is called
    ],
)
def test_a_level_or_delay_of_nothing_cannot_be_judged(tmp_path, paradigm, pairs):
    found = changed(tmp_path, *pairs, paradigms=[paradigm])
    assert "question[1].conditions" in [key for key, _ in found]
    assert "question[1].conditions" not in [key for key, _ in changed(tmp_path, *pairs)]


def test_a_file_name_that_is_too_long_is_a_mistake(tmp_path):
    found = changed(tmp_path, ('method = "band-pass"', f'method = "{"x" * 300}.wav"'))
    assert next(key for key, _ in found) == "question[1].conditions"


@pytest.mark.parametrize("broken", ['title = "t', "title = t", 'title = """t"'])
def test_beside_an_error_of_syntax_no_other_mistake_is_told(tmp_path, broken):
    found = changed(tmp_path, ('title = "t"', broken))
    assert all("is not TOML" in text for _, text in found), found
    assert len(found) == 1


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
