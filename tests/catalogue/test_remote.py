"""Sounds and results in remote storages: a real client of S3 with a server on loopback."""

import json
import os
import re

import pytest
import s3fs

from audioflinger_hook.catalogue.addresses import scrubbed
from tests.support.catalogues import library, manifest, results
from tests.support.commands import call, cushion
from tests.support.s3_server import BUCKET, KEY, SECRET, s3_server


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
    application.requests.clear()
    application.failures.clear()
    application.fails = lambda method, path: True
    return application, env, files, folder, local


def remote_results(files, folder):
    """Return the results in a folder of the bucket."""
    names = [name for name in files.find(folder) if not name.endswith((".json", ".jsonl"))]
    return {name.removeprefix(f"{folder}/"): files.cat_file(name) for name in names}


def expected(local, tmp_path):
    """Return the results of the same library on this machine."""
    assert call("catalogue", local, "--out", tmp_path / "local", "--workers", 1).code == 0
    return results(tmp_path / "local")


def test_sounds_and_results_in_s3_have_the_bytes_of_local_ones(store, tmp_path):
    _, _, files, folder, local = store
    arguments = ("catalogue", f"s3://{folder}/in", "--out", f"s3://{folder}/out", "--json")
    done = call(*arguments, "--workers", 1)
    assert (done.code, done.stderr) == (0, "")
    assert json.loads(done.stdout)["rendered"] == 4
    assert remote_results(files, f"{folder}/out") == expected(local, tmp_path)
    assert json.loads(call(*arguments, "--workers", 1).stdout)["skipped"] == 4
    files.pipe(f"{folder}/out/s01.wav", b"other")
    files.pipe(f"{folder}/in/s02.wav", files.cat_file(f"{folder}/in/s03.wav"))
    assert json.loads(call(*arguments, "--workers", 1).stdout)["rendered"] == 2
    status = call("catalogue", "status", *arguments[1:])
    assert json.loads(status.stdout)["done"] == 4


@pytest.mark.exhaustive
def test_worker_processes_reach_the_storage_by_themselves(store, tmp_path):
    _, env, files, folder, local = store
    lines = [{"audio": f"s3://{folder}/in/s{n:02d}.wav"} for n in range(4)]
    listed = manifest(tmp_path / "l.jsonl", *lines)
    out = f"s3://{folder}/out"
    done = cushion("catalogue", listed, "--out", out, "--workers", 2, env=env)
    assert (done.code, done.stderr) == (0, "")
    found = remote_results(files, f"{folder}/out")
    found = {name.rpartition("/")[2]: content for name, content in found.items()}
    assert found == expected(local, tmp_path)


@pytest.mark.parametrize(
    "failures",
    [[403], pytest.param([500, 403, 503, 500], marks=pytest.mark.exhaustive)],
)
@pytest.mark.parametrize(
    "method", ["PUT", "GET", pytest.param("HEAD", marks=pytest.mark.exhaustive)]
)
def test_a_storage_that_fails_and_then_works_loses_nothing(
    store, tmp_path, monkeypatch, failures, method
):
    application, _, files, folder, local = store
    waits: list[float] = []
    monkeypatch.setattr("time.sleep", waits.append)
    application.failures[:] = failures
    application.fails = lambda verb, path: verb == method and path.endswith(".wav")
    out = f"{folder}/{method}{len(failures)}"
    done = call("catalogue", f"s3://{folder}/in", "--out", f"s3://{out}", "--workers", 1)
    assert (done.code, done.stderr) == (0, "")
    assert application.failures == []
    assert 0.5 in waits
    assert remote_results(files, out) == expected(local, tmp_path)


def test_a_storage_that_stays_broken_fails_items_and_shows_no_credentials(store, monkeypatch):
    application, _, files, folder, _ = store
    monkeypatch.setattr("time.sleep", lambda seconds: None)
    application.failures[:] = [403] * 1_000
    application.fails = lambda method, path: "/in/" in path and path.endswith(".wav")
    listed = json.dumps({"audio": f"s3://{folder}/in/s00.wav"})
    files.pipe(f"{folder}/list.jsonl", listed.encode())
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


SIGNED = "https://user:hidden1@host/a.wav?X-Amz-Credential=hidden2&X-Amz-Signature=hidden3#hidden4"


@pytest.mark.parametrize(
    "arguments",
    [
        (SIGNED, "--out", "o"),
        ("list.jsonl", "--out", "o"),
        ("list.csv", "--out", "o"),
        ("in", "--out", SIGNED),
        ("in", "--out", "s3://hidden5:hidden6@bucket/x"),
        ("in", "--out", "o", "--dask", "tls://me:hidden7@127.0.0.1:1"),
    ],
)
def test_credentials_in_addresses_are_refused_and_never_shown(tmp_path, arguments, monkeypatch):
    monkeypatch.chdir(tmp_path)
    library(tmp_path / "in", 1)
    manifest(tmp_path / "list.jsonl", {"audio": SIGNED}, {"audio": "s3://a:hidden8@b/c.wav"})
    (tmp_path / "list.csv").write_text(f"audio\n{SIGNED}\n")
    done = call("catalogue", *arguments, "--debug")
    assert done.code in (2, 4)
    written = [path.read_text() for path in tmp_path.rglob("*.json*") if path.name != "list.jsonl"]
    for text in (done.stdout, done.stderr, *written):
        assert not re.search(r"hidden\d", text)


@pytest.mark.parametrize(
    "text",
    [
        "sent Authorization: Bearer hidden1",
        "headers {'Authorization': 'Bearer hidden1', 'Cookie': 'a=hidden2; b=hidden3'}",
        '{"password": "hidden1 hidden2"}',
        'told "{\\"access_token\\": \\"hidden1 hidden2\\"}"',
        "GET /a/blob.wav?sv=2020&sig=hidden1%3D",
        "signed with aB1/hidden1/+xyz",
    ],
)
def test_what_storages_say_of_credentials_is_left_out(text, monkeypatch):
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "aB1/hidden1/+xyz")
    monkeypatch.setenv("SOME_KEY_FILE", "/etc/hosts")
    found = scrubbed(f"/etc/hosts: {text}")
    assert "hidden" not in found
    assert found.startswith("/etc/hosts: ")


def test_without_fsspec_local_paths_work_and_urls_name_the_extra(tmp_path):
    folder = library(tmp_path / "in", 2)
    without = "import sys\nfor name in ('fsspec', 's3fs', 'dask', 'distributed', 'av'):\n"
    without += "    sys.modules[name] = None\n"
    done = cushion("catalogue", folder, "--out", tmp_path / "o", "--workers", 1, prelude=without)
    assert (done.code, done.stderr) == (0, "")
    for arguments, extra in (
        ((folder, "--out", "s3://bucket/x"), "remote"),
        (("s3://bucket/x", "--out", tmp_path / "o"), "remote"),
        ((folder, "--out", tmp_path / "o", "--dask", "local"), "cluster"),
    ):
        done = cushion("catalogue", *arguments, prelude=without)
        assert done.code == 2
        assert done.stderr.count("\n") == 1
        assert f"haptic-cushion[{extra}]" in done.stderr


def test_a_storage_without_whole_uploads_gets_a_new_name_last(tmp_path, monkeypatch):
    from fsspec.implementations.local import LocalFileSystem

    seen = []
    put_file = LocalFileSystem.put_file

    def watched(self, source, target, *arguments, **options):
        seen.append(os.path.basename(target))  # noqa: PTH119
        return put_file(self, source, target, *arguments, **options)

    monkeypatch.setattr(LocalFileSystem, "put_file", watched)
    folder = library(tmp_path / "in", 2)
    out = f"local://{tmp_path}/out"
    for state in ("rendered", "skipped"):
        done = call("catalogue", folder, "--out", out, "--workers", 1, "--json")
        assert json.loads(done.stdout)[state] == 2
    assert results(tmp_path / "out") == expected(folder, tmp_path)
    assert all(name.startswith(".") and name.endswith(".part") for name in seen)
    assert not [name for name in os.listdir(tmp_path / "out") if name.startswith(".")]  # noqa: PTH208
