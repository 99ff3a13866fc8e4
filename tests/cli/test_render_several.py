"""`cushion render IN... --out-dir DIR`: several files at once, each as if alone."""

import json
import os
import signal
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import psutil
import pytest

from tests.support.commands import (
    RATE,
    call,
    cushion,
    environment,
    held_back,
    listing,
    noise,
    refused,
    sound,
    start,
    until,
    workers_of,
)

WORKERS = [pytest.param(1, marks=pytest.mark.exhaustive), 2]


@pytest.fixture
def sources(tmp_path):
    """Four files of several lengths, rates and channel counts."""
    folder = tmp_path / "in"
    folder.mkdir()
    return [
        sound(folder / "a.wav", noise(40_000, 2)),
        sound(folder / "b.flac", 0.5 * noise(9_000), 8_000, format="FLAC", subtype="PCM_16"),
        sound(folder / "c.wav", noise(30_000, 3), 44_100),
        sound(folder / "d.e.wav", noise(500, 1)),
    ]


@pytest.fixture
def folder(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    return out


@pytest.mark.parametrize(
    ("form", "workers"),
    [
        pytest.param("live", 1, marks=pytest.mark.exhaustive),
        ("live", 2),
        pytest.param("reference", 5, marks=pytest.mark.exhaustive),
    ],
)
def test_each_file_has_the_bytes_that_it_has_alone(sources, folder, tmp_path, workers, form):
    alone = tmp_path / "alone.wav"
    done = cushion(
        "render", *sources, "--out-dir", folder, "--workers", workers, "--transform", form
    )
    assert (done.code, done.stderr) == (0, "")
    assert sorted(listing(folder)) == ["a.wav", "b.wav", "c.wav", "d.e.wav"]
    for source in sources:
        assert call("render", source, alone, "--transform", form).code == 0
        assert (folder / f"{source.stem}.wav").read_bytes() == alone.read_bytes()


@pytest.mark.exhaustive
def test_what_is_said_comes_in_the_order_of_the_files(sources, folder):
    asked = ["render", *reversed(sources), "--out-dir", folder, "--workers", 2]
    lines = cushion(*asked).stdout.splitlines()
    assert [line.split(":")[0] for line in lines] == [
        str(folder / f"{source.stem}.wav") for source in reversed(sources)
    ]
    document = json.loads(cushion(*asked, "--json").stdout)
    assert [entry["input"] for entry in document["files"]] == [str(s) for s in reversed(sources)]
    assert document["files"][-1]["frames"] == 40_000
    assert all({"peak", "latency_s", "samplerate"} <= entry.keys() for entry in document["files"])


@pytest.mark.sweep
@pytest.mark.parametrize("workers", WORKERS)
def test_one_bad_file_is_named_and_the_others_are_rendered(sources, folder, tmp_path, workers):
    bad = tmp_path / "bad.wav"
    bad.write_text("no sound")
    asked = ["render", sources[0], bad, *sources[1:], "--out-dir", folder, "--workers", workers]
    done = cushion(*asked)
    assert done.code == 2
    (error,) = done.stderr.splitlines()
    assert error.startswith("cushion: error: ")
    assert str(bad) in error
    assert len(done.stdout.splitlines()) == 4
    assert sorted(listing(folder)) == ["a.wav", "b.wav", "c.wav", "d.e.wav"]
    done = cushion(*asked, "--json")
    assert done.code == 2
    failed = json.loads(done.stdout)["files"][1]
    assert failed["input"] == str(bad)
    assert failed["exit_code"] == 2
    assert str(bad) in failed["error"]


@pytest.mark.exhaustive
def test_a_file_that_cannot_be_written_is_named_with_its_source(sources, folder):
    (folder / "a.wav").mkdir()
    done = cushion("render", *sources, "--out-dir", folder)
    assert done.code == 2
    (error,) = done.stderr.splitlines()
    assert str(sources[0]) in error
    assert "it is a folder" in error
    assert len(done.stdout.splitlines()) == 3


@pytest.mark.exhaustive
def test_a_warning_names_its_file(sources, folder):
    cut = sources[0]
    os.truncate(cut, cut.stat().st_size // 2)
    done = cushion("render", *sources, "--out-dir", folder)
    assert done.code == 0
    (warning,) = done.stderr.splitlines()
    assert warning.startswith(f"cushion: warning: {cut}")
    assert "shorter than its header says" in warning


def test_one_file_alone_may_have_a_folder_too(sources, folder):
    assert call("render", sources[0], "--out-dir", folder).code == 0
    assert list(listing(folder)) == ["a.wav"]


def test_options_may_stand_between_the_files(sources, folder):
    one, two = sources[:2]
    done = call("render", one, "--json", "--out-dir", folder, two, "--channels", "each")
    assert done.code == 0
    assert [entry["channels"] for entry in json.loads(done.stdout)["files"]] == [2, 1]
    assert call("render", one, "--json", folder / "only.wav").code == 0


def test_what_cannot_be_meant_is_refused_before_anything_is_done(sources, folder, tmp_path):
    twin = sound(tmp_path / "a.flac", noise(100), format="FLAC", subtype="PCM_16")
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
        assert words in refused(call("render", *arguments))
    assert not listing(folder)


# --- the end in the middle


@pytest.fixture(scope="module")
def long_sources(tmp_path_factory):
    """Three minutes of noise in several files, so that two are always under way."""
    folder = tmp_path_factory.mktemp("long")
    minute = np.tile(noise(RATE, 2), (60, 1))
    return [sound(folder / f"{n}.wav", minute, subtype="PCM_16") for n in range(3)]


needs_proc = pytest.mark.skipif(sys.platform != "linux", reason="asks /proc for the processes")


def written(pid: int, folder: Path) -> int:
    """Bytes that a process has written in a folder so far."""
    process: Any = SimpleNamespace(pid=pid)
    return sum(held_back(process, folder))


def two_under_way(process, folder):
    """Wait until two workers have each written half a megabyte; return them."""

    found: list[psutil.Process] = []

    def both_write():
        found[:] = workers_of(process)
        return len(found) == 2 and all(written(one.pid, folder) > 500_000 for one in found)

    until(both_write, process)
    return found


@pytest.mark.exhaustive
@needs_proc
@pytest.mark.parametrize(
    ("name", "whom"),
    [
        ("SIGINT", "its whole group, as a terminal does"),
        pytest.param("SIGINT", "the command", marks=pytest.mark.exhaustive),
        pytest.param("SIGTERM", "the command", marks=pytest.mark.exhaustive),
        pytest.param(
            "SIGTERM", "its whole group, as a terminal does", marks=pytest.mark.exhaustive
        ),
        pytest.param("SIGHUP", "its whole group, as a terminal does", marks=pytest.mark.exhaustive),
    ],
)
def test_an_interruption_ends_every_worker_and_leaves_nothing_half_written(
    long_sources, folder, name, whom
):
    (folder / "0.wav").write_bytes(b"old")
    options = ["--out-dir", folder, "--workers", 2, "--channels", "each"]
    with start("render", *long_sources, *options, start_new_session=True) as process:
        workers = two_under_way(process, folder)
        send = os.kill if whom == "the command" else os.killpg
        send(process.pid, signal.Signals[name])
        stdout, stderr = process.communicate(timeout=20)
    assert (process.returncode, stdout) == (130, "")
    assert stderr == "cushion: interrupted\n"
    assert listing(folder) == {"0.wav": b"old"}
    _, alive = psutil.wait_procs(workers, timeout=20)
    assert not alive


@pytest.mark.exhaustive
@needs_proc
def test_a_worker_that_is_killed_costs_no_file(long_sources, folder):
    options = ["--out-dir", folder, "--workers", 2, "--channels", "each"]
    with start("render", *long_sources, *options) as process:
        two_under_way(process, folder)[0].kill()
        stdout, stderr = process.communicate(timeout=60)
    assert (process.returncode, stderr) == (0, "")
    assert len(stdout.splitlines()) == len(long_sources)
    assert sorted(listing(folder)) == sorted(source.name for source in long_sources)


def test_a_file_that_ends_its_worker_again_and_again_is_named_and_costs_no_other(
    sources, folder, tmp_path
):
    site = tmp_path / "site"
    site.mkdir()
    # Every process of the command imports this: as a decoder that crashes.
    (site / "sitecustomize.py").write_text(
        "import os, sys\n"
        "def ended(event, arguments):\n"
        "    if event == 'open' and str(arguments[0]).endswith('c.wav'):\n"
        "        os._exit(9)\n"
        "sys.addaudithook(ended)\n"
    )
    env = {"PYTHONPATH": f"{site}{os.pathsep}{environment()['PYTHONPATH']}"}
    done = cushion("render", *sources, "--out-dir", folder, "--workers", 2, env=env)
    assert done.code == 5
    (error,) = done.stderr.splitlines()
    assert f"{sources[2]}: its process died twice" in error
    assert sorted(listing(folder)) == ["a.wav", "b.wav", "d.e.wav"]


@pytest.mark.exhaustive
@needs_proc
def test_workers_end_by_themselves_where_the_command_was_killed(long_sources, folder):
    options = ["--out-dir", folder, "--workers", 2, "--channels", "each"]
    with start("render", *long_sources, *options) as process:
        two_under_way(process, folder)
        process.kill()
        # The workers have its pipes, too: they are closed once both have ended.
        process.communicate(timeout=20)
    assert not listing(folder)
