"""`cushion fit` with simulated people: errors, guesses, kill -9, files, and what it changes."""

import json
import resource
import signal
from dataclasses import replace

import numpy as np
import pytest
import soundfile

from audioflinger_hook.cli.parser import build_parser
from audioflinger_hook.cli.run import _run_config
from audioflinger_hook.config import fits
from audioflinger_hook.config.file import load
from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.fit import PROTOCOL as P
from audioflinger_hook.fit.curve import CurvePosterior
from audioflinger_hook.fit.session import FitSession, FittedPerson, tones
from audioflinger_hook.service.status import ExposureFigures
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.mapping import VibrationMapping
from audioflinger_hook.trials.player import opened
from audioflinger_hook.trials.record import Rows, TrialRecord, run
from device.errors import LostError, UsageError, WriteError
from tests.support.commands import call, document, refused, start
from tests.support.data import table
from tests.support.signals import tone
from tests.support.trials import PLAYED, Answers, Player
from tests.support.trials import person as person_of
from tools.bench.sections.fit import RANDOM, fitted, sitter

RATE_HZ = P.rate_hz
CURVE = {"25": -15.0, "40": -4.0, "70": 0.0, "100": 5.0, "200": -7.0}


@pytest.fixture
def state(tmp_path, monkeypatch):
    """The folder of fits of a user who has none yet."""
    for name in ("XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(tmp_path))
    return tmp_path / "cushion/fit"


@pytest.fixture
def person(tmp_path):
    """Writes the file of a simulated person, and returns its path."""

    def write(**facts):
        path = tmp_path / "sitter.json"
        path.write_text(json.dumps({"curve_db": CURVE, **facts}))
        return path

    return write


def test_curves_of_people_are_found_and_guesses_refused():
    errors_db = []
    for seed in range(1_000, 1_020):
        session, errors, trials = fitted(sitter(seed))
        assert (trials <= 60, session.refusal) == (True, "")
        errors_db.append(np.sqrt(np.mean(errors**2)))
        assert fitted(sitter(seed, RANDOM))[0].refusal
    assert np.median(errors_db) <= 1.5
    assert np.percentile(errors_db, 90) <= 2.5


def test_an_answer_informs_its_neighbours_and_half_an_answer_is_between():
    def after(stronger):
        posterior = CurvePosterior()
        before = posterior.curve_db.copy(), posterior.uncertainty_db.copy()
        posterior.add(148.6, -posterior.curve_db[6], stronger)
        return (posterior.curve_db - before[0])[:8], (posterior.uncertainty_db - before[1])[:8]

    (up, _), (down, _), (none, surer) = after(1.0), after(0.0), after(0.5)
    assert up[5:].min() > 0.1 > -0.1 > down[5:].max()
    assert abs(none[6]) < 0.2 * up[6]
    assert (surer[5:] < -0.1).all()


@pytest.mark.parametrize("given", ["first", "second", "unknown"])
def test_whoever_gives_one_answer_to_everything_is_refused(given):
    session = FitSession(sitter(0), 3)
    list(run(Rows(), session, lambda trial: {"answer": given}))
    assert session.refusal


def test_answers_that_contradict_each_other_are_refused_though_catch_trials_are_right():
    session = FitSession(sitter(0), 3)
    said = {"test_first": True, "answer": "first"}
    for _ in range(5):
        session.take({"hz": 70.0, "level_db": 12.0, **said})
    assert session.refusal == ""
    for hz in (25.0, 61.0, 110.4, 200.0):  # stronger when it is weak, and weaker when it is strong
        session.take({"hz": hz, "level_db": -12.0, **said})
        session.take({"hz": hz, "level_db": 12.0, **said, "answer": "second"})
    assert "contradict" in session.refusal


def test_kill_9_loses_no_answer_and_the_fit_goes_on_to_the_same_result(state, person, tmp_path):
    asked = ("fit", "--simulate", person(), "--seed", 4, "--json")
    whole = document(*asked)
    last = (state / "simulated.last.jsonl").read_bytes()
    env = {"XDG_STATE_HOME": str(tmp_path / "killed")}
    record = tmp_path / "killed/cushion/fit/simulated.jsonl"
    kills = 0
    while kills < 3:
        with start(*asked, env=env) as process:
            enough = 15 * (kills + 1)
            while not (record.exists() and record.read_bytes().count(b"\n") > enough):
                assert process.poll() is None
            process.kill()
        kept = record.read_bytes()
        assert last.startswith(kept[: kept.rindex(b"\n") + 1])
        with record.open("ab") as torn:
            torn.write(b'{"trial":')
        kills += 1
    with start(*asked, env=env) as process:
        resumed = json.loads(process.communicate()[0])
    assert resumed["resumed_trials"] >= 45
    assert resumed["curve_db"] == whole["curve_db"]
    assert record.with_suffix(".last.jsonl").read_bytes() == last


def test_a_record_has_one_design_and_one_user_and_survives_a_full_disk(tmp_path):
    path = tmp_path / "record"
    with TrialRecord(path, "a", header={"seed": 1}) as record:
        record.append({"trial": 0})
        with pytest.raises(UsageError, match="another cushion process"):
            TrialRecord(path, "a")
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 5, hard))
        try:
            with pytest.raises(WriteError, match="1 trials are saved"):
                record.append({"trial": 1})
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
            signal.signal(signal.SIGXFSZ, before)
        assert path.read_bytes().endswith(b'{"trial":0}\n')
        record.append({"trial": 1})
    whole = path.read_bytes()
    path.write_bytes(whole + b'{"trial":')
    with TrialRecord(path, "a") as record:
        assert path.read_bytes() == whole
        assert (record.trials, record.header["seed"]) == ([{"trial": 0}, {"trial": 1}], 1)
    with pytest.raises(UsageError, match="another design"):
        TrialRecord(path, "b")


@pytest.mark.parametrize(
    ("facts", "said"),
    [
        ({"curve_db": None}, ["curve_db is not a table of frequencies"]),
        *(
            ({"curve_db": curve}, ["curve_db is not a table of frequencies"])
            for curve in ({}, {"70": "x"}, {"0": 1}, {"a": 2}, {"70": 1e9}, {"70": True}, [1], "")
        ),
        ({"jnd_db": 0, "lapse": 2, "seed": 1.5}, ["jnd_db", "lapse", "seed"]),
        ({"jnd": 1, "lapse": True}, ["did you mean 'jnd_db'", "lapse is not a number"]),
    ],
)
def test_all_mistakes_of_a_sitter_are_said_at_once(state, person, facts, said):
    error = refused(call("fit", "--simulate", person(**facts)))
    for part in said:
        assert part in error
    assert not state.exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    table("wrong-usage.toml")["fit"],
)
def test_wrong_usage_is_refused_in_one_line(state, arguments, said):
    assert said in refused(call("fit", *arguments.split()))


def test_refused_answers_keep_the_old_fit_and_a_fit_can_be_undone(state, person, tmp_path):
    kept = document("fit", "--simulate", person(), "--seed", 1)
    before = (state / "simulated.toml").read_bytes()
    done = call("fit", "--simulate", person(lapse=1.0), "--seed", 1, "--json")
    assert (done.code, json.loads(done.stdout)["accepted"]) == (2, False)
    assert "earlier fit stays" in done.stderr
    assert (state / "simulated.toml").read_bytes() == before
    later = document("fit", "--simulate", person(seed=9), "--seed", 1)
    assert later["curve_db"] != kept["curve_db"]
    document("fit", "--simulate", person(), "--name", "other")
    assert "dB against other" in call("fit", "--show", "other", "simulated").stdout
    assert [fit["name"] for fit in document("fit", "--show")] == ["other", "simulated"]
    drawn = call("fit", "--show", "simulated").stdout.splitlines()[1:]
    middles = [line.index("o", line.index("|")) - line.index("|") - 21 for line in drawn]
    assert middles == [round(level_db) for level_db in later["curve_db"].values()]
    assert call("fit", "--undo", "simulated").code == 0
    assert (state / "simulated.toml").read_bytes() == before
    assert fits.read("simulated").curve_db == kept["curve_db"]
    call("fit", "--undo", "simulated")
    assert fits.names() == ["other"]


@pytest.mark.parametrize("profile", ["paper", "cinema"])
def test_strength_fit_changes_a_render_by_the_curve(profile, state, person, tmp_path):
    curve = document("fit", "--simulate", person(), "--seed", 1)["curve_db"]
    parameters, levels_db = parameters_of(profile), {}
    sound, out, config = (tmp_path / name for name in ("in.wav", "out.wav", "config.toml"))
    for strength in ("flat", "fit"):
        fit = 'fit = "simulated"'
        config.write_text(f'profile = "{profile}"\n[transform]\nstrength = "{strength}"\n{fit}\n')
        for hz in (25.5, 50.0, 70.0, 110.4, 200.0):
            heard_hz = VibrationMapping.of(parameters).audio_hz(hz)
            soundfile.write(sound, tone(heard_hz, 3.0, RATE_HZ, 0.1), RATE_HZ, "FLOAT")
            assert call("render", sound, out, "--config", config).code == 0
            frames = soundfile.read(out)[0][RATE_HZ : -RATE_HZ // 2]
            levels_db[strength, hz] = 10.0 * np.log10(np.mean(frames**2))
    known = np.log([*map(float, curve)]), [*curve.values()]
    fit_db = {hz: db for (name, hz), db in levels_db.items() if name == "fit"}
    changes_db = {hz: db - levels_db["flat", hz] for hz, db in fit_db.items()}
    for hz, change_db in changes_db.items():
        wanted_db = min(12.0, -np.interp(np.log(hz), *known))
        assert change_db - changes_db[70.0] == pytest.approx(wanted_db, abs=0.3)


def test_without_a_name_the_fit_of_the_device_counts_and_a_missing_one_is_said(state, tmp_path):
    config, said = tmp_path / "config.toml", '[transform]\nstrength = "fit"\n'
    config.write_text(f'device = "sink:a"\n{said}')
    assert "cannot be used (no fit 'sink-a'; none" in refused(call("check", "--config", config))
    for name, device in (("sink-a", "sink:a"), ("sink-b", "sink:b"), ("mine", "sink:b")):
        curve = {"25": 0.0, "200": float(len(device) + len(name))}
        fits.store(fits.Fit(name, device, "today", 40, 1.0, curve, curve))
    parsed = build_parser().parse_args(["run", "--config", str(config), "--device", "b"])
    assert _run_config(parsed).settings.parameters.fit == "25:0.0,200:12.0"
    assert load(config).settings.choosing(profile="game").parameters.fit == "25:0.0,200:12.0"
    config.write_text(said)  # the file needs no device
    assert _run_config(parsed).settings.parameters.fit == "25:0.0,200:12.0"
    config.write_text('device = "hw:"\n')  # a wrong one is told, though another is used
    with pytest.raises(UsageError, match="line 1: device"):
        _run_config(parsed)
    config.write_text(f'{said}fit = "mine"\n')
    assert load(config).settings.transform_parameters.fit == "25:0.0,200:10.0"
    config.write_text(f'{said}fit = "tow"\n')
    assert "no fit 'tow'" in refused(call("check", "--config", config))
    text = (state / "mine.toml").read_text()
    for damaged in ("curve_db = 3", text.replace("25 = 0.0", "25 = nan"), text[: len(text) // 2]):
        (state / "mine.toml").write_text(damaged)
        with pytest.raises(UsageError, match=r"the fit .*mine.toml"):
            fits.read("mine")


def test_gains_are_cut_at_12_db_which_is_said_and_without_loudness_control_never_above_0(
    state, person
):
    curve = "25:-30,70:0,200:20"
    gains = LiveDesign.of(parameters_of("cinema", {"strength": "fit", "fit": curve}), RATE_HZ)
    weak = {"25": -30.0, "45.3": -30.0, "70": 0.0, "200": 0.0}
    shown = call("fit", "--simulate", person(curve_db=weak), "--seed", 1).stdout.splitlines()
    marked = [line.split()[0] for line in shown if "cut at +12 dB" in line]
    assert marked == ["25.0", "33.6", "45.3"]
    assert 1.0 / gains.strength.felt_weights.min() == pytest.approx(10**0.6)
    plain, cut = (
        LiveDesign.of(parameters_of("paper", said), RATE_HZ).synthesis.gain_table
        for said in ({}, {"strength": "fit", "fit": curve})
    )
    assert (cut / plain).max() == pytest.approx(1.0)


def test_the_level_starts_low_is_raised_by_the_person_and_lowered_by_protection():
    player = Player({4: replace(PLAYED, protection_db=3.0)})
    said = ["softer", "louder", "louder", "again", *["louder"] * 99, "good", "again", "first"]
    who = FittedPerson(person_of(player, Answers(*said)))
    test = {"hz": 25.0, "level_db": P.peak_dbfs - who.reference_dbfs}
    answer = who.answer({**test, "trial": 0, "test_first": True})
    peaks_db = [20.0 * np.log10(np.abs(frames).max()) for _, frames in player.played]
    raised_db = np.array(peaks_db[:7]) - P.start_dbfs
    assert raised_db == pytest.approx([0.0, 0.0, 3.0, 6.0, 3.0, 6.0, 9.0], abs=0.1)
    assert max(peaks_db) <= P.peak_dbfs
    kept = {key: answer[key] for key in ("answer", "again", "reference_dbfs")}
    assert kept == {"answer": "first", "again": 1, "reference_dbfs": -12.0}


def test_a_fit_ends_at_half_of_an_exposure_action_value():
    player = Player(exposure=ExposureFigures(1.0, 0.0, 0.26, 0.0, False, False, 0.0))
    with pytest.raises(UsageError, match="half of the action value"):
        FittedPerson(person_of(player, Answers()))
    assert player.played == []
    assert len(tones((25.0, -20.0))) == round(0.7 * RATE_HZ)


def test_nobody_waits_for_a_daemon_that_has_ended(state, monkeypatch):
    looks: list[float] = [0.0]
    monkeypatch.setenv("PULSE_SERVER", "unix:/nowhere")

    def clock() -> float:
        looks.append(0.0)
        return 0.0

    told = pytest.raises(LostError, match=r"see what `.* run --device sink:x` says")
    with told, opened("sink:x", clock):
        pass
    assert len(looks) < 200  # of 10 in a second
