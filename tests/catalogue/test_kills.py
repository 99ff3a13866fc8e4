"""Workers and clients that are killed at random moments: nothing is lost, nothing half."""

import contextlib
import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from audioflinger_hook.catalogue.storage import PART, LocalStorage
from tests.support.catalogues import library, manifest, results, rows
from tests.support.commands import call, cushion, environment, start, until

ITEMS = 16
FRAMES = 240_000
"""30 s at 8 kHz: some 50 ms for an item, so that a kill meets work."""


@pytest.fixture(scope="module")
def sounds(tmp_path_factory):
    return library(tmp_path_factory.mktemp("library") / "in", ITEMS, FRAMES)


@pytest.fixture(scope="module")
def expected(sounds, tmp_path_factory):
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    assert call("catalogue", sounds, "--out", out, "--workers", 1).code == 0
    return results(out)


def finished(out):
    """Return the results that have a record, and what each file is known by."""
    names = [path.name.removesuffix(".json") for path in out.glob("s*.json")]
    return {name: (out / name).stat().st_ino for name in names if (out / name).exists()}


def whole(out, expected):
    """Whether all that is in a folder are results with the right bytes, some or all."""
    found = {name: each for name, each in results(out).items() if not name.startswith(PART)}
    return all(expected[name] == content for name, content in found.items())


def after_some_work(process, out, draw):
    """Return once a random number of results is there, at a random moment."""
    most = draw.randrange(1, ITEMS - 4)
    until(lambda: out.is_dir() and len(list(out.glob("s*.json"))) >= most, process)
    time.sleep(draw.uniform(0.0, 0.1))


def workers_of(process):
    """Return the worker processes of a run, not the server that forks them."""
    return [
        worker for server in psutil.Process(process.pid).children() for worker in server.children()
    ]


SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.exhaustive) for seed in range(1, 3))]


@pytest.mark.parametrize("seed", SEEDS)
def test_killed_local_workers_lose_nothing(sounds, expected, tmp_path, seed):
    out, draw = tmp_path / "out", random.Random(seed)
    with start("catalogue", sounds, "--out", out, "--workers", 2, "--json") as process:
        after_some_work(process, out, draw)
        victims = workers_of(process)
        for victim in draw.sample(victims, min(len(victims), draw.choice((1, 1, 2)))):
            with contextlib.suppress(psutil.NoSuchProcess):
                victim.kill()
        before = finished(out)
        stdout, stderr = process.communicate(timeout=60)
    assert (process.returncode, stderr) == (0, "")
    assert json.loads(stdout)["items"] == ITEMS
    assert results(out) == expected
    # Finished results were not made again: at most the item under way in each worker was.
    assert before.items() <= finished(out).items()


@pytest.mark.parametrize("seed", SEEDS)
def test_a_killed_client_loses_nothing_and_leaves_no_process(sounds, expected, tmp_path, seed):
    out, draw = tmp_path / "out", random.Random(seed)
    workers = draw.choice((1, 2)) if seed else 2
    with start("catalogue", sounds, "--out", out, "--workers", workers) as process:
        after_some_work(process, out, draw)
        helpers = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=60)
    _, alive = psutil.wait_procs(helpers, timeout=30)
    assert not alive
    assert whole(out, expected)
    before = finished(out)
    assert len([name for name in results(out) if name[0] != "."]) - len(before) <= workers
    done = cushion("catalogue", sounds, "--out", out, "--workers", 2, "--json")
    assert (done.code, done.stderr) == (0, "")
    assert json.loads(done.stdout)["skipped"] == len(before)
    assert results(out) == expected
    assert before.items() <= finished(out).items()


def test_only_parts_of_dead_processes_that_this_one_can_see_are_removed(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    host, numbering = socket.gethostname(), Path("/proc/self/ns/pid").stat().st_ino
    with subprocess.Popen(["true"]) as ended:
        pass
    dead = f"{PART}{host}+{numbering}+{ended.pid}+0123.wav"
    kept = [
        f"{PART}{host}+{numbering}+{os.getpid()}+0123.wav",
        f"{PART}{host}+{numbering + 1}+{ended.pid}+0123.wav",  # of another container
        f"{PART}other+{numbering}+{ended.pid}+0123.wav",
    ]
    for name in (dead, f".{dead}.4567.part", *kept):
        (out / name).touch()
    LocalStorage(out).put("a.wav", lambda path: path.write_bytes(b"a"))
    assert sorted(path.name for path in out.iterdir()) == sorted(["a.wav", *kept])


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.exhaustive)]
)
@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.exhaustive), 2])
def test_an_interrupted_run_keeps_whole_items_and_the_next_goes_on(
    sounds, expected, tmp_path, number, workers
):
    out = tmp_path / "out"
    with start(
        "catalogue", sounds, "--out", out, "--workers", workers, start_new_session=True
    ) as process:
        after_some_work(process, out, random.Random(1))
        os.killpg(process.pid, number)  # as a terminal does: to the workers, too
        _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert stderr == "cushion: interrupted\n"
    assert whole(out, expected)
    assert not list(out.glob(".*"))
    before = finished(out)
    assert call("catalogue", sounds, "--out", out, "--workers", 1).code == 0
    assert results(out) == expected
    assert before.items() <= finished(out).items()


def test_an_item_that_ends_its_worker_fails_alone(tmp_path):
    """A decoder that crashes: here the item's rig makes the process end itself."""
    folder, out = library(tmp_path / "in", 8, 20_000), tmp_path / "out"
    site = tmp_path / "site"
    site.mkdir()
    # Every process of the run imports this: the worker that opens s03 ends at once.
    (site / "sitecustomize.py").write_text(
        "import os, sys\n"
        "def ended(event, arguments):\n"
        "    if event == 'open' and str(arguments[0]).endswith('s03.wav'):\n"
        "        os._exit(9)\n"
        "sys.addaudithook(ended)\n"
    )
    env = {"PYTHONPATH": f"{site}{os.pathsep}{environment()['PYTHONPATH']}"}
    done = cushion("catalogue", folder, "--out", out, "--workers", 2, "--json", env=env)
    assert done.code == 5
    assert "its worker died 2 times" in done.stderr
    found = json.loads(done.stdout)
    assert (found["rendered"] + found["skipped"], found["failed"]) == (7, 1)
    assert [row["id"] for row in rows(out / "failed.jsonl")] == ["s03"]
    assert len(results(out)) == 7


class Cluster:
    """A Dask scheduler and workers, each a process of its own."""

    def __init__(self, folder):
        self._file = folder / "scheduler.json"
        self._program = str(Path(sys.executable).with_name("dask"))
        self._folder = folder
        self.scheduler = self._start(
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
            "--scheduler-file", str(self._file),
        )  # fmt: skip
        until(self._ready, self.scheduler)
        self.workers = []

    def _ready(self):
        with contextlib.suppress(OSError, ValueError):
            return bool(self.address)
        return False

    @property
    def address(self):
        return json.loads(self._file.read_text())["address"]

    def add_worker(self):
        self.workers.append(
            self._start(
                "worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard",
                "--local-directory", str(self._folder),
            )
        )  # fmt: skip

    def _start(self, *arguments):
        return subprocess.Popen(
            [self._program, *arguments],
            env=environment(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", range(2))
def test_dask_workers_that_are_killed_and_added_lose_nothing(sounds, expected, tmp_path, seed):
    out, draw = tmp_path / "out", random.Random(seed)
    with Cluster(tmp_path) as cluster:
        for _ in range(2):
            cluster.add_worker()
        arguments = ("catalogue", sounds, "--out", out, "--dask", cluster.address, "--json")
        with start(*arguments, warnings="default") as process:
            after_some_work(process, out, draw)
            draw.choice(cluster.workers).kill()
            before = finished(out)
            cluster.add_worker()
            stdout, stderr = process.communicate(timeout=60)
        assert process.returncode == 0, stderr
        assert json.loads(stdout)["items"] == ITEMS
        assert results(out) == expected
        assert before.items() <= finished(out).items()
        with start(*arguments, warnings="default") as process:  # the client
            process.kill()
            process.communicate()
        done = cushion(*arguments, warnings="default")
        assert json.loads(done.stdout)["skipped"] == ITEMS


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", range(1))
def test_a_killed_dask_client_loses_nothing(sounds, expected, tmp_path, seed):
    out, draw = tmp_path / "out", random.Random(seed)
    with Cluster(tmp_path) as cluster:
        cluster.add_worker()
        cluster.add_worker()
        arguments = ("catalogue", sounds, "--out", out, "--dask", cluster.address, "--json")
        with start(*arguments, warnings="default") as process:
            after_some_work(process, out, draw)
            process.kill()
            process.communicate()
        before = finished(out)
        done = cushion(*arguments, warnings="default")
        assert done.code == 0, done.stderr
        assert results(out) == expected
        assert before.items() <= finished(out).items()


@pytest.mark.exhaustive
def test_a_scheduler_that_goes_away_ends_the_run_with_advice(sounds, expected, tmp_path):
    out = tmp_path / "out"
    with Cluster(tmp_path) as cluster:
        cluster.add_worker()
        arguments = ("catalogue", sounds, "--out", out, "--dask", cluster.address)
        with start(*arguments, warnings="default") as process:
            after_some_work(process, out, random.Random(1))
            cluster.scheduler.kill()
            _, stderr = process.communicate(timeout=60)
    assert process.returncode == 4
    assert stderr.splitlines()[-1].startswith("cushion: error: the Dask scheduler at tcp://127")
    assert "Traceback" not in stderr
    assert whole(out, expected)
    assert cushion("catalogue", sounds, "--out", out, "--workers", 2).code == 0
    assert results(out) == expected


@pytest.mark.exhaustive
def test_a_local_dask_cluster_gives_the_same_bytes(sounds, expected, tmp_path):
    out = tmp_path / "out"
    listed = manifest(
        tmp_path / "l.jsonl", *({"audio": str(path), "id": path.stem} for path in sounds.iterdir())
    )
    done = cushion(
        "catalogue", listed, "--out", out, "--dask", "local", "--workers", 2, warnings="default"
    )
    assert (done.code, done.stderr) == (0, "")
    assert results(out) == expected


def test_a_scheduler_that_is_not_there_is_an_error_of_one_line(sounds, tmp_path, monkeypatch):
    monkeypatch.setattr("audioflinger_hook.catalogue.executors.CONNECT_S", "0.5s")
    done = call("catalogue", sounds, "--out", tmp_path / "out", "--dask", "tcp://127.0.0.1:9")
    assert done.code == 4
    assert done.stderr.startswith("cushion: error: no Dask scheduler answers at tcp://127.0.0.1:9")
    assert done.stderr.count("\n") == 1
