"""The model of the simulated rig, as a user chooses it, and what the reports say about it."""

import json
import re
from importlib.resources import files

import numpy as np
import pytest
import soundfile

from tests.support.commands import call
from tests.support.signals import tone

RATE = 48_000

PAPER = files("device.rig").joinpath("paper.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    path = tmp_path_factory.mktemp("sound") / "in.wav"
    soundfile.write(path, 0.5 * tone(300.0, 2.5, RATE), RATE, "FLOAT")
    return path


def rig_file(folder, change):
    path = folder / "mine.toml"
    path.write_text(change(PAPER), encoding="utf-8")
    return path


def without(stage):
    return lambda text: re.sub(rf"\[{stage}\].*?(?=\n\[)", "", text, flags=re.DOTALL)


def reported(sound, folder, *options):
    felt = folder / "a.wav"
    done = call("render", sound, folder / "out.wav", "--acceleration", felt, "--json", *options)
    assert (done.code, done.stderr) == (0, "")
    return json.loads(done.stdout), soundfile.read(felt)[0]


def test_each_second_says_its_model_cost_and_true_error(sound, tmp_path):
    for model, percent, least, most in (
        ("linear", 0.0, 1e-3, 5.0),
        ("nonlinear", 100.0, 0.0, 0.05),
        ("auto", None, 0.0, 1.0),
    ):
        report, _ = reported(sound, tmp_path, "--model", model)
        seconds = report["models"]
        assert [one["second"] for one in seconds] == [0, 1, 2]
        assert all(one["cost_ms"] > 0.0 for one in seconds)
        assert all(least <= one["error_percent"] <= most for one in seconds)
        if percent is not None:
            assert {one["nonlinear_percent"] for one in seconds} == {percent}


def test_in_words_consecutive_seconds_of_one_model_share_a_line(sound, tmp_path):
    felt = tmp_path / "a.wav"
    done = call("render", sound, tmp_path / "o.wav", "--acceleration", felt, "--model", "nonlinear")
    assert done.code == 0
    line = done.stdout.splitlines()[1]
    assert re.fullmatch(
        r"  0 to 3 s: non-linear model, \S+ ms of CPU a second, true error up to \S+ %", line
    )


def test_a_smaller_tolerance_comes_closer_to_the_non_linear_model(sound, tmp_path):
    true = reported(sound, tmp_path, "--model", "nonlinear")[1]
    off = [
        np.abs(reported(sound, tmp_path, "--tolerance", tolerance)[1] - true).max()
        for tolerance in ("1", "0.0001")
    ]
    assert off[1] <= 1e-4 * np.abs(true).max()
    assert off[1] < 0.1 * off[0]


def test_a_rig_without_large_signal_data_is_linear_unless_asked_otherwise(sound, tmp_path):
    rig = rig_file(tmp_path, without("large_signal"))
    report, _ = reported(sound, tmp_path, "--rig", rig)
    assert {one["nonlinear_percent"] for one in report["models"]} == {0.0}
    assert {one["error_percent"] for one in report["models"]} == {0.0}
    out, felt = tmp_path / "none.wav", tmp_path / "no.wav"
    done = call("render", sound, out, "--acceleration", felt, "--rig", rig, "--model", "nonlinear")
    assert done.code == 2
    assert "large_signal.stop_m is missing" in done.stderr
    assert "--model linear" in done.stderr
    assert not out.exists()
    assert not felt.exists()


@pytest.mark.parametrize("command", ["render", "demo", "run"])
@pytest.mark.parametrize("tolerance", ["0", "-0.1", "nan", "1.01", "inf"])
def test_a_tolerance_out_of_range_is_refused_with_the_range(command, tolerance, sound, tmp_path):
    arguments = {
        "render": [sound, tmp_path / "o.wav"],
        "demo": ["--out", tmp_path / "demo"],
        "run": ["--device", "twin", "--tap", f"file:{sound}"],
    }[command]
    done = call(command, *arguments, f"--tolerance={tolerance}")
    assert done.code == 2
    assert "allowed: 1e-05 to 1" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_stops_that_are_too_hard_for_the_model_are_named_and_leave_no_file(sound, tmp_path):
    def hard(text):
        text = re.sub(r"(?m)^x_max_m = .*$", "x_max_m = 2e-6", text)
        text = re.sub(r"(?m)^stop_m = .*$", "stop_m = 3e-6", text)
        return re.sub(r"(?m)^stop_n_per_m2 = .*$", "stop_n_per_m2 = 1e24", text)

    rig = rig_file(tmp_path, hard)
    out, felt = tmp_path / "none.wav", tmp_path / "no.wav"
    done = call("render", sound, out, "--acceleration", felt, "--rig", rig, "--model", "nonlinear")
    assert done.code == 2
    assert "stops are too hard" in done.stderr
    assert "Traceback" not in done.stderr
    assert not out.exists()
    assert not felt.exists()
