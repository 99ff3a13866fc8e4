import json
import os
import re
import signal

import numpy as np
import psutil
import pytest

from tests.support import commands


@pytest.fixture
def sources(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    return [
        commands.sound(folder / "a.wav", commands.noise(40_000, 2)),
        commands.sound(
            folder / "b.flac", 0.5 * commands.noise(9_000), 8_000, format="FLAC", subtype="PCM_16"
        ),
        commands.sound(folder / "c.wav", commands.noise(30_000, 3), 44_100),
        commands.sound(folder / "d.e.wav", commands.noise(500, 1)),
    ]


@pytest.mark.sweep
@pytest.mark.parametrize(("form", "workers"), [("live", 2), ("live", 1), ("reference", 5)])
def test_each_file_is_as_if_alone_and_told_of_in_its_turn(sources, folder, tmp_path, workers, form):
    alone = tmp_path / "alone.wav"
    options = ["--out-dir", folder, "--workers", workers, "--transform", form]
    done = commands.cushion("render", *reversed(sources), *options)
    assert (done.code, done.stderr) == (0, "")
    outputs = [folder / f"{source.stem}.wav" for source in sources]
    assert sorted(commands.listing(folder)) == [path.name for path in outputs]
    told = [line.split(":")[0] for line in done.stdout.splitlines()]
    assert told == [str(path) for path in reversed(outputs)]
    for source, path in zip(sources, outputs, strict=True):
        assert commands.call("render", source, alone, "--transform", form).code == 0
        assert path.read_bytes() == alone.read_bytes()
    done = commands.cushion("render", *reversed(sources), *options, "--json")
    found = json.loads(done.stdout)["files"]
    assert [entry["input"] for entry in found] == [str(source) for source in reversed(sources)]
    assert found[-1]["frames"] == 40_000
    assert all({"peak", "latency_s", "samplerate"} <= entry.keys() for entry in found)


@pytest.mark.sweep
@pytest.mark.parametrize("workers", [2, 1])
def test_one_bad_file_is_named_and_the_others_are_rendered(sources, folder, tmp_path, workers):
    bad = tmp_path / "bad.wav"
    bad.write_text("no sound")
    asked = ["render", sources[0], bad, *sources[1:], "--out-dir", folder, "--workers", workers]
    done = commands.cushion(*asked)
    assert done.code == 2
    (error,) = done.stderr.splitlines()
    assert re.match(f"cushion: error: .*{bad}", error)
    assert len(done.stdout.splitlines()) == 4
    assert sorted(commands.listing(folder)) == ["a.wav", "b.wav", "c.wav", "d.e.wav"]
    done = commands.cushion(*asked, "--json")
    assert done.code == 2
    failed = json.loads(done.stdout)["files"][1]
    assert (failed["input"], failed["exit_code"]) == (str(bad), 2)
    assert str(bad) in failed["error"]


@pytest.mark.exhaustive
def test_what_is_wrong_with_a_file_is_told_with_its_name(sources, folder):
    (folder / "a.wav").mkdir()
    cut = sources[2]
    os.truncate(cut, cut.stat().st_size // 2)
    done = commands.cushion("render", *sources, "--out-dir", folder)
    assert done.code == 2
    warning, error = sorted(done.stderr.splitlines(), key=lambda line: "error" in line)
    assert warning.startswith(f"cushion: warning: {cut}")
    assert "shorter than its header says" in warning
    assert str(sources[0]) in error
    assert "it is a folder" in error
    assert len(done.stdout.splitlines()) == 3


def test_options_may_stand_between_the_files(sources, folder):
    one, two = sources[:2]
    told = commands.document("render", one, "--out-dir", folder, two, "--channels", "each")
    assert [entry["channels"] for entry in told["files"]] == [2, 1]
    assert commands.document("render", one, folder / "only.wav")["channels"] == 1
    assert len(commands.document("render", one, "--out-dir", folder)["files"]) == 1


def test_what_cannot_be_meant_is_refused_before_anything_is_done(sources, folder, tmp_path):
    twin = commands.sound(tmp_path / "a.flac", commands.noise(100), format="FLAC", subtype="PCM_16")
    a = sources[0]
    for arguments, words in (
        (["--out-dir", folder], "IN"),
        ([a, "--out-dir", tmp_path / "none"], "does not exist; create it"),
        ([a, "--out-dir", a], "is not a folder"),
        ([a, twin, "--out-dir", folder], "would both become"),
        ([a, a, "--out-dir", folder], "would both become"),
        ([sources[1], a, "--out-dir", a.parent], "would replace the input"),
        ([a, "--out-dir", folder, "--acceleration", folder / "x.wav"], "--acceleration"),
        ([a, "--out-dir", folder, "--workers", 0], "allowed: 1 to 256"),
        ([a, "--out-dir", folder, "--workers", 257], "allowed: 1 to 256"),
        ([a, "--out-dir", folder, "--workers", "two"], "is not a whole number"),
        ([a, "--out-dir", folder, "--transform", "alive"], "alive"),
        ([a, folder / "b.wav", "--workers", -1], "allowed: 1 to 256"),
    ):
        assert words in commands.refused(commands.call("render", *arguments))
    assert not commands.listing(folder)


@pytest.fixture(scope="module")
def long_sources(tmp_path_factory):
    folder = tmp_path_factory.mktemp("long")
    minute = np.tile(commands.noise(commands.RATE, 2), (60, 1))
    return [commands.sound(folder / f"{n}.wav", minute, subtype="PCM_16") for n in range(3)]


def two_under_way(process, folder):
    """Wait until two workers have each written half a megabyte; return them."""
    found: list[psutil.Process] = []

    def both_write():
        found[:] = commands.workers_of(process)
        held = [sum(commands.held_back(one, folder)) for one in found]
        return len(held) == 2 and min(held) > 500_000

    commands.until(both_write, process)
    return found


@pytest.mark.exhaustive
@pytest.mark.parametrize(  # a terminal signals the whole group
    ("name", "send"),
    [*(("SIGINT", os.killpg), ("SIGINT", os.kill), ("SIGTERM", os.kill), ("SIGHUP", os.killpg))],
)
def test_an_interruption_ends_all_workers_and_leaves_no_half_file(long_sources, folder, name, send):
    (folder / "0.wav").write_bytes(b"old")
    options = ["--out-dir", folder, "--workers", 2, "--channels", "each"]
    with commands.start("render", *long_sources, *options, start_new_session=True) as process:
        workers = two_under_way(process, folder)
        send(process.pid, signal.Signals[name])
        stdout, stderr = process.communicate(timeout=20)
    assert (process.returncode, stdout, stderr) == (130, "", "cushion: interrupted\n")
    assert commands.listing(folder) == {"0.wav": b"old"}
    _, alive = psutil.wait_procs(workers, timeout=20)
    assert not alive


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["SIGKILL", "SIGTERM", "SIGINT"])
def test_a_signal_in_the_middle_of_one_file_leaves_the_folder_as_it_was(long_sources, folder, name):
    if name == "SIGKILL" and not hasattr(os, "O_TMPFILE"):
        pytest.skip("where files cannot be nameless, kill -9 leaves a hidden .part file")
    out = folder / "vibration.wav"
    out.write_bytes(b"old")
    options = ["--channels", "each", "--acceleration", folder / "felt.wav"]
    with commands.start("render", long_sources[0], out, *options) as process:
        commands.until(lambda: sum(commands.held_back(process, folder)) > 400_000, process)
        process.send_signal(signal.Signals[name])
        stdout, stderr = process.communicate(timeout=10)
    assert commands.listing(folder) == {out.name: b"old"}
    killed = name == "SIGKILL"
    assert process.returncode == (-signal.SIGKILL if killed else 130)
    assert (stdout, stderr) == ("", "" if killed else "cushion: interrupted\n")


@pytest.mark.exhaustive
@pytest.mark.parametrize("victim", ["worker", "command"])
def test_a_killed_worker_costs_no_file_and_workers_end_with_their_command(
    long_sources, folder, victim
):
    options = ["--out-dir", folder, "--workers", 2, "--channels", "each"]
    with commands.start("render", *long_sources, *options) as process:
        workers = two_under_way(process, folder)
        (workers[0] if victim == "worker" else process).kill()
        # The workers have its pipes, too: they are closed once all have ended.
        stdout, stderr = process.communicate(timeout=60)
    names = [source.name for source in long_sources] if victim == "worker" else []
    assert sorted(commands.listing(folder)) == names
    if victim == "worker":
        assert (process.returncode, stderr, len(stdout.splitlines())) == (0, "", len(names))


def test_a_file_that_ends_all_its_workers_is_named_and_costs_no_other(sources, folder, tmp_path):
    env = commands.ended_by("c.wav", tmp_path)
    done = commands.cushion("render", *sources, "--out-dir", folder, "--workers", 2, env=env)
    assert done.code == 5
    assert done.stderr.count("\n") == 1, done.stderr
    assert f"{sources[2]}: its process died twice" in done.stderr
    assert sorted(commands.listing(folder)) == ["a.wav", "b.wav", "d.e.wav"]
