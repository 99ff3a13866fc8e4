"""Addresses of remote storages show no credentials, and what a storage lacks is done without."""

import json
import os
import re
import sys

import pytest

from audioflinger_hook.catalogue.addresses import scrubbed
from tests.support.catalogues import expected, library, manifest, results
from tests.support.commands import call, cushion, refused

SIGNED = "https://user:hidden1@host/a.wav?X-Amz-Credential=hidden2&X-Amz-Signature=hidden3#hidden4"


@pytest.mark.parametrize(
    "arguments",
    [
        *((SIGNED, "--out", "o"), ("list.jsonl", "--out", "o"), ("list.csv", "--out", "o")),
        *(("in", "--out", SIGNED), ("in", "--out", "s3://hidden5:hidden6@bucket/x")),
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


def test_without_fsspec_local_paths_work_and_urls_name_the_extra(tmp_path, monkeypatch):
    folder = library(tmp_path / "in", 2)
    lacking = dict.fromkeys(("fsspec", "s3fs", "dask", "distributed", "av"))
    without = f"import sys\nsys.modules |= {lacking}\n"
    done = cushion("catalogue", folder, "--out", tmp_path / "o", "--workers", 1, prelude=without)
    assert (done.code, done.stderr) == (0, "")
    for name in lacking:
        monkeypatch.setitem(sys.modules, name, None)
    for arguments, extra in (
        ((folder, "--out", "s3://bucket/x"), "remote"),
        (("s3://bucket/x", "--out", tmp_path / "o"), "remote"),
        ((folder, "--out", tmp_path / "o", "--dask", "local"), "cluster"),
    ):
        assert f"haptic-cushion[{extra}]" in refused(call("catalogue", *arguments))


def test_a_storage_without_whole_uploads_gets_a_new_name_last(tmp_path, monkeypatch):
    from fsspec.implementations.local import LocalFileSystem

    seen, put_file = [], LocalFileSystem.put_file

    def watched(self, source, target, *arguments, **options):
        seen.append(os.path.basename(target))  # noqa: PTH119
        return put_file(self, source, target, *arguments, **options)

    monkeypatch.setattr(LocalFileSystem, "put_file", watched)
    folder, out = library(tmp_path / "in", 2), f"local://{tmp_path}/out"
    for state in ("rendered", "skipped"):
        done = call("catalogue", folder, "--out", out, "--workers", 1, "--json")
        assert json.loads(done.stdout)[state] == 2
    assert results(tmp_path / "out") == expected(folder, tmp_path)
    assert all(name.startswith(".") and name.endswith(".part") for name in seen)
    assert not [name for name in os.listdir(tmp_path / "out") if name.startswith(".")]  # noqa: PTH208
