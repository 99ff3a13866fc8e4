"""Sounds and results in S3: a real client with a server on loopback, see `make test-s3`."""

import json

import pytest

from tests.support.catalogues import expected, library, manifest
from tests.support.commands import call, cushion

s3fs = pytest.importorskip("s3fs", reason="run `make test-s3`")
pytest.importorskip("moto", reason="run `make test-s3`")
from tests.support.s3_server import BUCKET, KEY, SECRET, s3_server  # noqa: E402

pytestmark = pytest.mark.s3


@pytest.fixture(scope="module")
def server():
    """A server, the environment of its clients, and a client."""
    with s3_server() as (application, env), pytest.MonkeyPatch.context() as patch:
        for name, value in env.items():
            patch.setenv(name, value)
        s3fs.S3FileSystem.clear_instance_cache()
        files = s3fs.S3FileSystem(use_listings_cache=False, skip_instance_cache=True)
        files.mkdir(BUCKET)
        yield application, env, files
        s3fs.S3FileSystem.clear_instance_cache()


@pytest.fixture
def store(server, tmp_path, request):
    """The server, and a library in a folder of its own and on this machine."""
    application, env, files = server
    folder = f"{BUCKET}/{request.node.name.partition('[')[0]}"
    local = library(tmp_path / "in")
    files.put(f"{local}/", f"{folder}/in/", recursive=True)
    application.failures.clear()
    application.fails = lambda method, path: True
    return application, env, files, folder, local


def remote_results(files, folder):
    names = [name for name in files.find(folder) if not name.endswith((".json", ".jsonl"))]
    return {name.removeprefix(f"{folder}/"): files.cat_file(name) for name in names}


def test_sounds_and_results_in_s3_have_the_bytes_of_local_ones(store, tmp_path):
    _, _, files, folder, local = store
    arguments = ("catalogue", f"s3://{folder}/in", "--out", f"s3://{folder}/out", "--json")
    done = call(*arguments, "--workers", 1)
    assert (done.code, done.stderr, json.loads(done.stdout)["rendered"]) == (0, "", 4)
    assert remote_results(files, f"{folder}/out") == expected(local, tmp_path)
    assert json.loads(call(*arguments, "--workers", 1).stdout)["skipped"] == 4
    files.pipe(f"{folder}/out/s01.wav", b"other")
    files.pipe(f"{folder}/in/s02.wav", files.cat_file(f"{folder}/in/s03.wav"))
    assert json.loads(call(*arguments, "--workers", 1).stdout)["rendered"] == 2
    assert json.loads(call("catalogue", "status", *arguments[1:]).stdout)["done"] == 4


def test_worker_processes_reach_the_storage_by_themselves(store, tmp_path):
    _, env, files, folder, local = store
    lines = [{"audio": f"s3://{folder}/in/s{n:02d}.wav"} for n in range(4)]
    listed, out = manifest(tmp_path / "l.jsonl", *lines), f"s3://{folder}/out"
    done = cushion("catalogue", listed, "--out", out, "--workers", 2, env=env)
    assert (done.code, done.stderr) == (0, "")
    found = remote_results(files, f"{folder}/out")
    found = {name.rpartition("/")[2]: content for name, content in found.items()}
    assert found == expected(local, tmp_path)


@pytest.mark.parametrize("failures", [[403], [500, 403, 503, 500]])
@pytest.mark.parametrize("method", ["PUT", "GET", "HEAD"])
def test_a_storage_that_fails_a_while_loses_nothing(store, tmp_path, monkeypatch, failures, method):
    application, _, files, folder, local = store
    waits: list[float] = []
    monkeypatch.setattr("time.sleep", waits.append)
    application.failures[:] = failures
    application.fails = lambda verb, path: verb == method and path.endswith(".wav")
    out = f"{folder}/{method}{len(failures)}"
    done = call("catalogue", f"s3://{folder}/in", "--out", f"s3://{out}", "--workers", 1)
    assert (done.code, done.stderr, application.failures) == (0, "", [])
    assert 0.5 in waits
    assert remote_results(files, out) == expected(local, tmp_path)


def test_a_storage_that_stays_broken_fails_items_and_shows_no_credentials(store, monkeypatch):
    application, _, files, folder, _ = store
    monkeypatch.setattr("time.sleep", lambda seconds: None)
    application.failures[:] = [403] * 1_000
    application.fails = lambda method, path: "/in/" in path and path.endswith(".wav")
    files.pipe(f"{folder}/list.jsonl", json.dumps({"audio": f"s3://{folder}/in/s00.wav"}).encode())
    out = f"s3://{folder}/out"
    done = call("catalogue", f"s3://{folder}/list.jsonl", "--out", out, "--workers", 1, "--debug")
    assert done.code == 2
    assert "the storage failed" in done.stderr
    application.failures.clear()
    texts = [done.stdout, done.stderr]
    texts += [files.cat_file(name).decode() for name in files.find(f"{folder}/out")]
    for text in texts:
        assert KEY not in text
        assert SECRET not in text
    assert any('"error"' in text for text in texts)
