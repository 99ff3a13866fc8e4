import re
from importlib.resources import files

import numpy as np
import pytest

from tests.support.commands import RATE, call, document, refused, sound, vibration
from tests.support.signals import tone

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
