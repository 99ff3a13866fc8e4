"""What is played: all conditions of a trial are equally strong, as measured from the files."""

from hashlib import sha256

import numpy as np
import pytest
import soundfile
from scipy.signal import sosfilt

from audioflinger_hook.study.design_check import load
from audioflinger_hook.study.stimuli import Stimuli
from audioflinger_hook.study.trials import Trial
from device.drive.exposure import wk_sections
from device.errors import UsageError
from tests.support.studies import make_study

MATCHED_DB = 0.5


def weighted_db(path):
    vibration, rate = soundfile.read(path)
    return 10 * np.log10(np.sum(sosfilt(wk_sections(rate), vibration) ** 2))


@pytest.mark.parametrize("level_db", [-50, -40, 0])
def test_all_conditions_of_a_trial_have_the_same_weighted_level(tmp_path, level_db):
    more = '[[condition]]\nname = "d"\nmethod = "cinema"\ndelay_ms = 40'
    design = make_study(tmp_path, "preference")
    text = (
        (tmp_path / "design.toml").read_text().replace("level_db = -40", f"level_db = {level_db}")
    )
    text = text.replace('["a", "b", "c"]', '["a", "b", "c", "d"]') + more
    (tmp_path / "design.toml").write_text(text)
    stimuli = Stimuli(load(tmp_path))
    files = [stimuli.vibration(Trial("preference", "x", (name, "a")), 0) for name in "abcd"]
    levels = [weighted_db(file.path) for file in files]
    assert max(levels) - min(levels) < MATCHED_DB
    assert max(file.peak_dbfs for file in files) <= 0.0
    assert (stimuli.lowered_db["x"] > 1.0) == (level_db == 0)
    if level_db:
        assert [file.weighted_db for file in files] == pytest.approx([level_db] * 4, abs=MATCHED_DB)
    assert files[0].digest == sha256(files[0].path.read_bytes()).hexdigest()
    assert files[0].digest != files[3].digest
    assert design.digest != stimuli.design.digest


def test_an_offset_delays_the_vibration_by_exactly_that_time(tmp_path):
    stimuli = Stimuli(make_study(tmp_path, "synchrony"))
    trials = {ms: Trial("synchrony", "x", ("a",), (), ms) for ms in (-200.0, 0.0, 120.0)}
    files = {ms: stimuli.vibration(trial, 0) for ms, trial in trials.items()}
    signals = {ms: soundfile.read(file.path)[0] for ms, file in files.items()}
    for ms, signal in signals.items():
        assert np.array_equal(np.roll(signals[0.0], round(48 * ms)), signal)
    sound, _ = soundfile.read(files[0.0].sound)
    assert len(sound) == len(signals[0.0])


def test_adaptive_levels_and_silence_are_what_they_say(tmp_path):
    stimuli = Stimuli(make_study(tmp_path, "threshold"))
    trial = Trial("threshold", "x", ("a", "none"), gains_db=(-12.0, 0.0))
    assert stimuli.vibration(trial, 0).weighted_db == pytest.approx(-52.0, abs=0.1)
    silent = stimuli.vibration(trial, 1)
    assert silent.weighted_db == -np.inf
    assert not soundfile.read(silent.path)[0].any()
    loud = Trial("threshold", "x", ("a", "none"), gains_db=(80.0, 0.0))
    with pytest.raises(UsageError, match="exceed full scale"):
        stimuli.vibration(loud, 0)


def test_a_vibration_may_be_a_file_of_the_sounds_length(tmp_path):
    make_study(tmp_path, "preference")
    text = (tmp_path / "design.toml").read_text()
    (tmp_path / "design.toml").write_text(text.replace('"envelope"', '"v-{stimulus}.wav"'))
    for name, frames in (("x", 9_600), ("y", 5_000)):
        soundfile.write(tmp_path / f"v-{name}.wav", np.sin(np.arange(frames) / 90), 48_000)
    stimuli = Stimuli(load(tmp_path))
    assert stimuli.vibration(Trial("preference", "x", ("b", "a")), 0).weighted_db == pytest.approx(
        -40, abs=0.01
    )
    with pytest.raises(UsageError, match="make both equal"):
        stimuli.vibration(Trial("preference", "y", ("b", "a")), 0)
