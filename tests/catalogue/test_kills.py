import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Any

import psutil
import pytest

from audioflinger_hook.catalogue.storage import LocalStorage
from audioflinger_hook.offline import batch
from device.atomic_file import PREFIX, temporary_folder
from tests.support import commands
from tests.support.catalogues import expected as results_of
from tests.support.catalogues import library, results, rows
from tests.support.commands import call, cushion, ended_by, environment, start, until, workers_of

ITEMS = 16
FRAMES = 240_000
"""30 s at 8 kHz: some 50 ms for an item, so that a kill meets work."""


@pytest.fixture(scope="module")
def sounds(tmp_path_factory):
    return library(tmp_path_factory.mktemp("library") / "in", ITEMS, FRAMES)


@pytest.fixture(scope="module")
def expected(sounds, tmp_path_factory):
    return results_of(sounds, tmp_path_factory.mktemp("undisturbed"))


def finished(out):
    """Return the results that have a record, and what each file is known by."""
    names = [path.name.removesuffix(".json") for path in out.glob("s*.json")]
    return {name: (out / name).stat().st_ino for name in names if (out / name).exists()}


def whole(out, expected):
    return all(
        expected[name] == content
        for name, content in results(out).items()
        if not name.startswith(PREFIX)
    )


def after_some_work(process, out, draw):
    most = draw.randrange(1, ITEMS - 4)
    until(lambda: out.is_dir() and len(list(out.glob("s*.json"))) >= most, process)
    time.sleep(draw.uniform(0.0, 0.1))


@pytest.mark.sweep
@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.soak) for n in (1, 2))])
@pytest.mark.parametrize("harm", ["client", "workers", signal.SIGINT, signal.SIGTERM])
def test_a_run_that_is_killed_or_interrupted_loses_nothing_and_the_next_goes_on(
    sounds, expected, tmp_path, harm, seed
):
    out, draw = tmp_path / "out", random.Random(seed)
    run = ("catalogue", sounds, "--out", out, "--workers", 2, "--json")
    quiet = "ignore::ResourceWarning"  # of a file that Python is opening at the interrupt
    with start(*run, start_new_session=True, warnings=quiet) as process:
        after_some_work(process, out, draw)
        helpers, before = psutil.Process(process.pid).children(recursive=True), finished(out)
        if harm == "workers":
            victims = workers_of(process)
            for victim in draw.sample(victims, min(len(victims), draw.choice((1, 1, 2)))):
                with contextlib.suppress(psutil.NoSuchProcess):
                    victim.kill()
        elif harm == "client":
            process.kill()
        else:
            os.killpg(process.pid, harm)  # as a terminal does: to the workers, too
        stdout, stderr = process.communicate(timeout=60)
    _, alive = psutil.wait_procs(helpers, timeout=30)
    assert not alive
    assert whole(out, expected)
    if harm == "workers":
        assert (process.returncode, stderr, json.loads(stdout)["items"]) == (0, "", ITEMS)
        assert results(out) == expected
    elif harm != "client":
        assert (process.returncode, stderr) == (130, "cushion: interrupted\n")
        assert not list(out.glob(".*"))
    # Finished results are not made again: at most the item under way in each worker is.
    kept = finished(out)
    assert before.items() <= kept.items()
    assert len([name for name in results(out) if name[0] != "."]) - len(kept) <= 2
    done = call("catalogue", sounds, "--out", out, "--workers", 1, "--json")
    assert (done.code, done.stderr) == (0, "")
    assert (json.loads(done.stdout)["skipped"], results(out)) == (len(kept), expected)
    assert kept.items() <= finished(out).items()


def test_only_folders_of_this_computer_that_no_process_holds_are_removed(tmp_path):
    (tmp_path / f"{PREFIX}dead").mkdir()
    other = ".cushion-run-elsewhere-alive"  # with a lock that is not seen
    (tmp_path / other).mkdir()
    with temporary_folder(tmp_path) as held:
        LocalStorage(tmp_path).put("a.wav", lambda path: path.write_bytes(b"a"))
        assert {path.name for path in tmp_path.iterdir()} == {"a.wav", held.name, other}


@pytest.mark.parametrize("name", ["mkdir", "rmdir"])
def test_an_interrupt_while_a_folder_is_made_or_deleted_leaves_none(tmp_path, monkeypatch, name):
    real = getattr(os, name)

    def interrupted(*arguments, **options):
        monkeypatch.undo()
        if name == "mkdir":
            real(*arguments, **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, name, interrupted)
    with pytest.raises(KeyboardInterrupt), temporary_folder(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("workers", [1, 2])
def test_an_item_that_ends_its_worker_fails_alone_and_is_tried_again_on_request(tmp_path, workers):
    folder, out = library(tmp_path / "in", 8, 20_000), tmp_path / "out"
    env = ended_by("s03.wav", tmp_path)
    run = ("catalogue", folder, "--out", out, "--workers", workers, "--json")
    done = cushion(*run, env=env)
    assert done.code == 5
    assert "its worker died 2 times" in done.stderr
    found = json.loads(done.stdout)
    assert (found["rendered"] + found["skipped"], found["failed"]) == (7, 1)
    assert ([row["id"] for row in rows(out / "failed.jsonl")], len(results(out))) == (["s03"], 7)
    done = call(*run)  # in which the file would end nothing
    assert (done.code, "add --retry-died" in done.stderr) == (5, True)
    status = call("catalogue", "status", folder, "--out", out, "--json")
    assert json.loads(status.stdout)["unreadable"] == 1
    assert call(*run, "--retry-died").code == 0


def test_a_killed_run_leaves_no_folders_once_another_has_run(sounds, tmp_path):
    run = ("catalogue", sounds, "--out", tmp_path / "out", "--workers", 2)
    # 44 characters: the longest in which a socket has a place, whatever the computer's name
    with tempfile.TemporaryDirectory("_" * 28, dir="/tmp") as name:
        for _ in range(2):
            with start(*run, env={"TMPDIR": name}) as process:
                until(lambda: any(Path(name).glob("*/pymp-*")), process)
                process.kill()
        assert cushion(*run, env={"TMPDIR": name}).code == 0
        assert not list(Path(name).iterdir())


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_killed_fork_server_is_no_fault_of_an_item(sounds, expected, tmp_path, number):
    run = ("catalogue", sounds, "--out", tmp_path / "out", "--workers", 2)
    with start(*run) as process:
        until(lambda: bool(workers_of(process)), process)
        workers_of(process)[0].parent().send_signal(number)
        _, stderr = process.communicate(timeout=60)
    assert (process.returncode, stderr) == (0, "")
    assert results(tmp_path / "out") == expected


def kill_server():
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(60.0)


DEATHS: dict[str, tuple[Any, ...]] = {
    batch.DIED: (os._exit, 9),
    batch.ENDED: (os._exit, 1),
    "by SIGKILL, from outside": (signal.raise_signal, signal.SIGKILL),
    batch.NO_SERVER: (kill_server,),
}


@pytest.mark.parametrize("reason", DEATHS)
def test_the_cause_of_a_death_is_named(reason):
    with batch.LocalWorkers(2, "os") as place:
        future = place.submit(*DEATHS[reason])
        with pytest.raises(BrokenExecutor):
            future.result(60.0)
        assert place.death().startswith(reason)


class Cluster(contextlib.ExitStack):
    def __init__(self, folder):
        super().__init__()
        self._options = f"--nthreads 1 --no-nanny --no-dashboard --local-directory {folder}"
        file = folder / "scheduler.json"
        listens = f"--host 127.0.0.1 --port 0 --no-dashboard --scheduler-file {file}"
        self.scheduler = self._start(f"scheduler {listens}")
        until(lambda: file.exists() and file.read_text().endswith("}"), self.scheduler)
        self.address = json.loads(file.read_text())["address"]
        self.workers = []
        for _ in range(2):
            self.add_worker()

    def add_worker(self):
        self.workers.append(self._start(f"worker {self.address} {self._options}"))

    def _start(self, line):
        program = [str(Path(sys.executable).with_name("dask")), *line.split()]
        no = subprocess.DEVNULL
        process = subprocess.Popen(program, env=environment(), stdout=no, stderr=no, text=True)
        self.callback(process.wait)
        self.callback(process.kill)
        return process


@pytest.mark.exhaustive
@pytest.mark.parametrize("victim", ["worker", "client"])
def test_dask_workers_and_clients_that_are_killed_lose_nothing(sounds, expected, tmp_path, victim):
    out, draw = tmp_path / "out", random.Random(1)
    with Cluster(tmp_path) as cluster:
        arguments = ("catalogue", sounds, "--out", out, "--dask", cluster.address, "--json")
        with start(*arguments, warnings="default") as process:
            after_some_work(process, out, draw)
            (process if victim == "client" else draw.choice(cluster.workers)).kill()
            before = finished(out)
            cluster.add_worker()
            stdout, stderr = process.communicate(timeout=60)
        if victim == "worker":
            assert process.returncode == 0, stderr
            assert json.loads(stdout)["items"] == ITEMS
        done = cushion(*arguments, warnings="default")
        assert done.code == 0, done.stderr
        assert victim == "client" or json.loads(done.stdout)["skipped"] == ITEMS
    assert results(out) == expected
    assert before.items() <= finished(out).items()


@pytest.mark.exhaustive
def test_a_scheduler_that_goes_away_ends_the_run_with_advice(sounds, expected, tmp_path):
    out = tmp_path / "out"
    with Cluster(tmp_path) as cluster:
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
    options = ("--out", out, "--dask", "local", "--workers", 2)
    done = cushion("catalogue", sounds, *options, warnings="default")
    assert (done.code, done.stderr, results(out)) == (0, "", expected)


def test_a_scheduler_that_is_not_there_is_an_error_of_one_line(sounds, tmp_path, monkeypatch):
    monkeypatch.setattr("audioflinger_hook.catalogue.cluster.CONNECT_S", "0.5s")
    done = call("catalogue", sounds, "--out", tmp_path / "out", "--dask", "tcp://127.0.0.1:9")
    line = commands.refused(done, 4)
    assert line.startswith("cushion: error: no Dask scheduler answers at tcp://127.0.0.1:9")
