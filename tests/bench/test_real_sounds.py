from collections import Counter
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from device.errors import UsageError
from tests.support import signals
from tests.support.bench_runs import a_bench
from tests.support.recordings import require_recordings
from tools.bench import films
from tools.bench.figures.pictures import PICTURES
from tools.bench.machine import machine_facts
from tools.bench.methods import Method, function_method, other_methods, profile_methods
from tools.bench.report import BenchReport, Section
from tools.bench.sections import felt_levels, felt_speech, felt_times, speech_suppression
from tools.bench.sections import real_sounds as section
from tools.bench.sounds import real_sounds, speech_sounds
from tools.bench.sounds.signals import RECORDINGS_COMMAND, SAMPLERATE, examine_recordings, tone
from tools.bench.sounds.unpack_sounds import Choice, choices, name_hash
from tools.bench.workbench import QUICK, SUBJECTS, Workbench
from tools.records import PROJECT_ROOT

LIST = choices((PROJECT_ROOT / "tools/bench/sounds/real_sounds.txt").read_text("utf-8"))

UNCHANGED = Method("unchanged", lambda sound, _rate: sound, limited=True)
"""A method whose vibration is its sound."""


def sounds(*kinds):
    rng, decay = np.random.default_rng(3), np.exp(-np.arange(SAMPLERATE // 2) / 2_000.0)
    made = {kind: 0.3 * decay * rng.standard_normal(decay.size) for kind in kinds}
    return [real_sounds.RealSound(f"{kind}/made", kind, sound) for kind, sound in made.items()]


def test_the_list_asks_for_enough_of_every_class_and_chooses_the_same_from_any_order():
    most = Counter[str]()
    for line in LIST:
        most[line.kind] += line.most
    assert set(most) == set(real_sounds.KINDS)
    assert min(most.values()) >= 20
    assert most.total() >= 190
    line = Choice("shots", "game-data", 2, ("*/gun*.wav", "a.pk3:*.ogg"))
    paths = ["x/gun1.wav", "x/gun2.wav", "a.pk3:shot.ogg", "x/gun.ogg", "b.pk3:shot.ogg"]
    chosen = line.chosen(iter(paths))
    assert chosen == line.chosen(iter(reversed(paths)))
    assert chosen == sorted(paths[:3], key=name_hash)[:2]


@given(st.sets(st.text("abcdef", min_size=1)))
def test_halves_share_nothing_leave_nothing_out_and_are_as_large(names):
    choose, report = (real_sounds.in_half([*names], half) for half in ("choose", "report"))
    assert sorted(choose + report) == sorted(names) == real_sounds.in_half([*names], "all")
    assert len(choose) - len(report) in (0, 1)


def test_the_law_is_the_profiles_own_slope_and_one_law_where_loudness_is_not_followed():
    laws = {each.name: felt_levels.law_of(each) for each in profile_methods()}
    assert laws["paper"] == felt_levels.LAW == felt_levels.law_of(UNCHANGED)
    assert laws["music"] == parameters_of("music").dynamics
    assert [each.limited for each in profile_methods(["paper", "game"])] == [False, True]


@given(st.lists(st.floats(20.0, 100.0), min_size=2), st.floats(0.2, 1.0), st.floats(-40.0, 0.0))
def test_pairs_on_the_law_have_no_error_at_any_gain(heard, law, gain_db):
    phons = np.array(heard)
    errors = felt_levels.pair_errors_db(phons, law * phons + gain_db, law)
    assert errors.size == phons.size * (phons.size - 1) // 2
    assert errors == pytest.approx(0.0, abs=1e-9)
    # One sound of three that is 6 dB too strong is wrong in two pairs of three.
    share = felt_levels.pairs_within(np.zeros(3), np.array([0.0, 6.0, 0.0]))
    assert share == pytest.approx(100.0 / 3.0)


def test_a_programme_holds_every_sound_where_it_says():
    made = sounds("drums", "shots", "speech")
    played, places = felt_levels.programme(made)
    for each, place in zip(made, places, strict=True):
        assert np.array_equal(played[place][: each.sound.size], each.sound)


def test_a_method_that_changes_nothing_moves_as_the_swell_does(monkeypatch):
    monkeypatch.setattr(
        felt_levels, "slow_phon", lambda sound, every_s: felt_levels.pieces_db(sound, every_s)
    )
    monkeypatch.setattr(felt_levels, "LAW", 1.0)
    series: felt_levels.Series = {}
    rows = {row.name: row for row in felt_levels.crescendo_rows([UNCHANGED], series)}
    up = rows["crescendo of 30 dB in 16 s, up"]
    # The means of the two seconds beside each end are a second short of it.
    assert up.value == pytest.approx(30.0 * 15.0 / 16.0, abs=1.5)
    assert all(row.met for name, row in rows.items() if "off the law" in name)
    assert {"swell, sound", "swell, unchanged"} == set(series)


def test_a_method_that_changes_nothing_is_never_late_and_never_warbles():
    made = sounds("drums", "shots", "explosions", "music", "engines", "speech")
    series: felt_levels.Series = {}
    rows = [
        *felt_times.impact_rows([UNCHANGED], made, series),
        *felt_times.steady_rows([UNCHANGED], made, series),
    ]
    values = {row.name: row.value or 0.0 for row in rows}
    assert values["drums: half of the peak, 95th percentile"] == 0.0
    assert values["drums and shots: peak after the sound's, median"] == 0.0
    assert values["shots: felt as impacts"] == 2.0
    assert values["steady A-major chord: modulation at 4 to 16 Hz"] < 6.0
    assert len(series["drum, sound"]) == 200


def test_every_profile_has_every_row_and_only_paper_no_limit():
    made = sounds("speech")
    found = section.parts(profile_methods(), section.Material(made, made, 1, tones=1), {})
    names = ("tones", "beginnings", "sub-bass", "chirp", "rates", "channels", "ends")
    rows = [row for name in names for row in found[name]()]
    titles = {row.name for row in rows}
    assert {(row.name, row.column) for row in rows} == {
        (title, profile) for title in titles for profile in PROFILES
    }
    asked: dict[str, set[str]] = {profile: set() for profile in PROFILES}
    for row in rows:
        if row.must:
            asked[row.column].add(row.name)
    assert not asked["paper"]
    assert asked["cinema"] == asked["game"] == asked["music"]
    assert len(asked["cinema"]) >= 10
    # Deep tones and all tones are not speech.
    unasked = asked["cinema"] - asked["speech"]
    assert unasked == {title for title in titles if "tone, worst" in title or "off -18" in title}


def test_only_the_profile_for_speech_has_its_limits_and_every_third_word_is_20_db_softer():
    made, asked = sounds("speech", "music"), Method("speech", UNCHANGED.render, limited=True)
    for method, wanted in ((asked, True), (UNCHANGED, False)):
        rows = list(felt_speech.speech_rows([method], made))
        assert len(rows) == 3
        assert all(bool(row.must) == wanted for row in rows)
    played, places = felt_speech.softened([np.ones(4_800) for _ in range(6)])
    assert [(place.start, place.stop) for place in places] == [(200, 300), (500, 600)]
    assert played[9_600:14_400] == pytest.approx(0.1)
    assert played.sum() == pytest.approx(4.2 * 4_800)


def test_other_methods_have_no_latency_a_function_is_one_and_a_wrong_name_is_refused():
    onset = np.concatenate((np.zeros(SAMPLERATE), tone(150.0, 0.5, 1.0)))
    for method in other_methods():
        assert method.vibration(onset).size == onset.size
        assert not method.limited
    constant = other_methods()[0].vibration(onset)
    assert constant[:4_800] == pytest.approx(constant[48_000:52_800], abs=1e-9)
    assert function_method("numpy:negative").vibration(np.ones(3)) == pytest.approx(-1.0)
    with pytest.raises(UsageError, match="no MODULE:FUNCTION"):
        function_method("numpy:no_such_function")


def test_more_than_150_sounds_are_matched_only_where_no_value_is_chosen_on_them(monkeypatch):
    sounds_of = Mock(side_effect=lambda half, _: (half,))
    monkeypatch.setattr(section, "real_sounds", sounds_of)
    assert [str(one) for one in section.material("choose", None, 1).all] == ["choose"]
    assert [str(one) for one in section.material("report", None, 1).all] == ["all"]
    assert [asked.args[0] for asked in sounds_of.mock_calls] == ["choose", "report", "all"]


def test_without_sounds_command_and_section_name_what_fetches_them(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv(real_sounds.SOUNDS_VARIABLE, str(tmp_path / "none"))
    assert films.main([]) == 2
    assert real_sounds.SOUNDS_COMMAND in capsys.readouterr().err
    found = section.on_real_sounds(a_bench())
    assert (found.rows, [gone.command for gone in found.missing]) == (
        (),
        [real_sounds.SOUNDS_COMMAND],
    )


def test_the_picture_is_drawn_from_the_sections_series():
    pytest.importorskip("matplotlib")
    wave = tuple(np.linspace(0.1, 1.0, 40))
    series = {"drum, sound": wave, "swell, sound": wave}
    series |= {"film's parts": (1.0, 2.0, 3.0, 3.5), "film's strokes": (2.2, 2.9)}
    shown_methods = ["sound", *PROFILES, "constant"]
    series |= {f"film, {name}": wave for name in shown_methods}
    for name in PROFILES:
        series |= {f"{each}, {name}": wave for each in ("drum", "swell", "chord")}
    (picture,) = (each for each in PICTURES if each.section == section.TITLE)
    shown = Section(section.TITLE, "What it means.", (), series=series)
    report = BenchReport("", True, 0.0, machine_facts(), (shown,))
    assert picture.can_be_drawn(report)
    assert len(picture.drawn(report).axes) == len(shown_methods) + 3


@pytest.mark.exhaustive
def test_no_sound_is_in_both_halves():
    require_recordings()
    recordings = examine_recordings()[0]
    one, other = (
        {item.name for item in speech_sounds.desktop(recordings)[half]}
        for half in speech_sounds.HALVES
    )
    assert one
    assert other
    assert not one & other
    assert not any("channel" in name or name.startswith(("Front", "Rear")) for name in one | other)
    one, other = (set(speech_sounds.no_speech(2.0)[half]) for half in speech_sounds.HALVES)
    assert not one & other
    speech = speech_sounds.spoken(recordings)
    assert set(speech) == set(speech_sounds.HALVES)
    seconds = sum(len(item.frames) for item in recordings if item.is_speech) / SAMPLERATE
    # Every recording once, each with a pause of 0.1 s behind it.
    assert sum(sound.size for sound in speech.values()) == pytest.approx(
        SAMPLERATE * (seconds + 0.8), abs=1.0
    )


def test_sounds_are_as_loud_while_they_sound_whatever_silence_is_beside():
    sound = signals.tone(300, 1.0, SAMPLERATE, 0.01)
    between = speech_sounds.even(
        signals.joined(signals.silence(1.0, SAMPLERATE), sound, signals.silence(2.0, SAMPLERATE))
    )
    middle = between[SAMPLERATE + 4_800 : 2 * SAMPLERATE - 4_800]
    assert 10 * np.log10((middle**2).mean()) == pytest.approx(speech_sounds.LOUDNESS_DB, abs=0.3)


@pytest.mark.exhaustive
def test_hops_with_sound_are_counted_and_belief_is_that_of_the_live_form():
    speech = signals.joined(speech_sounds.scene_track("speech"), signals.silence(1.0, SAMPLERATE))
    found = speech_suppression.heard(speech)
    seconds = found.sounding.sum() * found.hop_s
    assert 1.5 < seconds < 2.2
    assert found.belief.max() == pytest.approx(1.0)
    assert not speech_suppression.heard(signals.white_noise(1.0, SAMPLERATE, 0.3)).belief.any()


@pytest.mark.exhaustive
def test_without_recordings_the_rest_is_measured_and_what_is_missing_is_named():
    found = speech_suppression.speech_suppression(Workbench(QUICK, SUBJECTS, ()))
    (gone,) = found.missing
    assert gone.command == RECORDINGS_COMMAND
    assert "recorded speech" in gone.name
    assert not any("recorded" in row.name for row in found.rows)
    values = {row.name: row.value or 0.0 for row in found.rows}
    assert values["synthetic speech, known"] > 90.0
    assert values["no speech: engine"] == 0.0
