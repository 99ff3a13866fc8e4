import functools
import re
from importlib.resources import files

import numpy as np
import pytest

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.recording import facts_of, settings_from
from device.drive import ActuatorSettings
from device.drive.outputs import FADE_S
from tests.support.commands import RATE, call, document, listing, noise, refused, sound, vibration
from tests.support.parameters import TWO_SHAKERS
from tests.support.signals import columns, tone


@pytest.fixture
def stereo(tmp_path):
    left, right = tone(110.0, 1.0, RATE, 0.4), tone(400.0, 1.0, RATE, 0.2)
    return sound(tmp_path / "in.wav", columns(left, right))


rendered = functools.partial(document, "render")


def test_the_mix_on_one_channel_is_exactly_that_without_any_table(tmp_path, config, stereo):
    plain, one = tmp_path / "plain.wav", tmp_path / "one.wav"
    report = rendered(stereo, plain)
    assert rendered(stereo, one, "--config", config("[[actuator]]\nchannels = [0]\n")) == report
    assert plain.read_bytes() == one.read_bytes()


def test_each_channel_has_its_level_polarity_and_delay_and_others_silence(tmp_path, config, stereo):
    each, out = tmp_path / "each.wav", tmp_path / "out.wav"
    rendered(stereo, each, "--channels", "each")
    text = (
        '[[actuator]]\nsource = "right"\nchannels = [3, 0]\ngain_db = -12\n'
        '[[actuator]]\nsource = "left"\nchannels = [2]\npolarity = "inverted"\ndelay_ms = 20\n'
    )
    report = rendered(stereo, out, "--config", config(text))
    wanted, got = vibration(each), vibration(out)
    assert (got.shape, report["channels"]) == ((RATE, 4), 4)
    late, quieter = round(0.02 * RATE), 10.0 ** (-12.0 / 20.0) * wanted[:, 1].astype(float)
    np.testing.assert_allclose(got[:, 0], quieter, atol=1e-7)  # float32 below 1
    assert np.array_equal(got[:, 3], got[:, 0])
    assert not got[:, 1].any()
    unfaded = len(got) - round(FADE_S * RATE)
    assert np.array_equal(got[late:unfaded, 2], -wanted[: unfaded - late, 0])
    # What is felt before the sound begins is late as well.
    assert np.abs(got[:late, 2]).max() <= np.abs(wanted[:late, 0]).max()
    assert report["peak"] == float(np.abs(got).max())


def test_protection_of_one_takes_no_time_from_the_others(tmp_path, config, stereo):
    plain, out = tmp_path / "plain.wav", tmp_path / "out.wav"
    rendered(stereo, plain, "--config", config(TWO_SHAKERS))
    rendered(stereo, out, "--config", config(TWO_SHAKERS + 'protection = "on"\n'))
    # Below what any rig limits protection changes nothing, and its time is taken out.
    assert plain.read_bytes() == out.read_bytes()


def test_the_acceleration_is_that_of_each_one_s_own_rig(tmp_path, config, stereo):
    def accelerations(text):
        path = tmp_path / "acceleration.wav"
        options = ("--acceleration", path, "--config", config(text))
        report = rendered(stereo, tmp_path / "out.wav", *options)
        return vibration(path), report["peak_acceleration_m_s2"]

    alike, _ = accelerations(TWO_SHAKERS)
    own, peak = accelerations(TWO_SHAKERS + 'rig = "consumer"\n')
    assert alike.shape == own.shape == (RATE, 2)
    assert np.array_equal(alike[:, 0], own[:, 0])
    assert not np.array_equal(alike[:, 1], own[:, 1])
    assert peak > 0.0


def test_settings_come_back_from_a_recording():
    actuators = (
        ActuatorSettings((1, "lfe"), "left", "consumer", -3.0, "inverted", 7.5),
        ActuatorSettings((0,), "right", damping="auto", protection="on"),
    )
    settings = Settings(actuators=actuators, rig="consumer")
    assert settings_from(facts_of(settings)) == settings
    assert "actuators" not in facts_of(Settings())


def test_replay_gives_what_render_gives(tmp_path, config, stereo):
    one, two, path = tmp_path / "one.wav", tmp_path / "two.wav", config(TWO_SHAKERS)
    assert call("capture", tmp_path / "cap", "--tap", f"file:{stereo}").code == 0
    rendered(stereo, one, "--config", path)
    document("replay", tmp_path / "cap", two, "--config", path)
    assert one.read_bytes() == two.read_bytes()


def test_what_cannot_be_is_one_line_and_leaves_no_file(tmp_path, config, stereo):
    for text, options, words in (
        ('[[actuator]]\nchannels = ["front-left"]\n', (), "channel front-left.*numbers only"),
        (TWO_SHAKERS, ("--channels", "each"), "'each' cannot be used with .*actuator"),
        (TWO_SHAKERS.replace("[1]", "[0]"), (), r"line 7: actuator\[2\].channels = \[0\] wants"),
    ):
        done = call("render", stereo, tmp_path / "out.wav", "--config", config(text), *options)
        assert re.search(words, refused(done))
        assert listing(tmp_path).keys() == {"in.wav", "config.toml"}


def test_low_rates_take_actuators_but_no_protection(tmp_path, config):
    source = sound(tmp_path / "in.wav", noise(2_000, 2), 4_000)
    rendered(source, tmp_path / "out.wav", "--config", config(TWO_SHAKERS))
    path = config(TWO_SHAKERS + 'protection = "on"\n')
    error = refused(call("render", source, tmp_path / "out.wav", "--config", path))
    assert "samplerate=4000" in error


PAPER = files("device.rig").joinpath("paper.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return sound(tmp_path_factory.mktemp("sound") / "in.wav", tone(300.0, 2.5, RATE, 0.5))


SMALL_SIGNAL = re.sub(r"\[large_signal\].*?(?=\n\[)", "", PAPER, flags=re.DOTALL)


def reported(source, folder, *options):
    files = (folder / "out.wav", "--acceleration", folder / "a.wav")
    return document("render", source, *files, *options), vibration(folder / "a.wav")


def refusal(source, folder, rig):
    (folder / "mine.toml").write_text(rig, encoding="utf-8")
    out, felt = folder / "none.wav", folder / "no.wav"
    options = ("--rig", folder / "mine.toml", "--model", "nonlinear")
    error = refused(call("render", source, out, "--acceleration", felt, *options))
    assert not out.exists()
    assert not felt.exists()
    return error


def test_each_second_says_its_model_cost_and_true_error(source, tmp_path):
    for model, percent, least, most in (
        ("linear", 0.0, 1e-3, 5.0),
        ("nonlinear", 100.0, 0.0, 0.05),
        ("auto", None, 0.0, 1.0),
    ):
        report, _ = reported(source, tmp_path, "--model", model)
        seconds = report["models"]
        assert [one["second"] for one in seconds] == [0, 1, 2]
        assert all(one["cost_ms"] > 0.0 for one in seconds)
        assert all(least <= one["error_percent"] <= most for one in seconds)
        if percent is not None:
            assert {one["nonlinear_percent"] for one in seconds} == {percent}


def test_in_words_consecutive_seconds_of_one_model_share_a_line(source, tmp_path):
    options = ("--acceleration", tmp_path / "a.wav", "--model", "nonlinear")
    done = call("render", source, tmp_path / "o.wav", *options)
    assert done.code == 0
    line = done.stdout.splitlines()[1]
    said = r"  0 to 3 s: non-linear model, \S+ ms of CPU a second, true error up to \S+ %"
    assert re.fullmatch(said, line)


def test_a_smaller_tolerance_comes_closer_to_the_non_linear_model(source, tmp_path):
    true = reported(source, tmp_path, "--model", "nonlinear")[1]
    found = (reported(source, tmp_path, "--tolerance", one)[1] for one in ("1", "0.0001"))
    off = [np.abs(acceleration - true).max() for acceleration in found]
    assert off[1] <= 1e-4 * np.abs(true).max()
    assert off[1] < 0.1 * off[0]


def test_a_rig_without_large_signal_data_is_linear_unless_asked_otherwise(source, tmp_path):
    error = refusal(source, tmp_path, SMALL_SIGNAL)
    assert "large_signal.stop_m is missing" in error
    assert "--model linear" in error
    report, _ = reported(source, tmp_path, "--rig", tmp_path / "mine.toml")
    assert {one["nonlinear_percent"] for one in report["models"]} == {0.0}
    assert {one["error_percent"] for one in report["models"]} == {0.0}


@pytest.mark.parametrize("command", ["render", "demo", "run"])
def test_a_tolerance_out_of_range_is_refused_with_the_range(command, source, tmp_path):
    arguments = {
        "render": [source, tmp_path / "o.wav"],
        "demo": ["--out", tmp_path / "demo"],
        "run": ["--device", "twin", "--tap", f"file:{source}"],
    }[command]
    for tolerance in ("0", "-0.1", "nan", "1.01", "inf"):
        error = refused(call(command, *arguments, f"--tolerance={tolerance}"))
        assert "allowed: 1e-05 to 1" in error


def test_stops_that_are_too_hard_for_the_model_are_named_and_leave_no_file(source, tmp_path):
    hard = PAPER
    for name, value in (("x_max_m", "2e-6"), ("stop_m", "3e-6"), ("stop_n_per_m2", "1e24")):
        hard = re.sub(rf"(?m)^{name} = .*$", f"{name} = {value}", hard)
    assert "stops are too hard" in refusal(source, tmp_path, hard)
