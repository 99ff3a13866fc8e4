"""What the doctor reads of folders and the journal, and the order in which it prints and writes."""

import json
from dataclasses import replace

import pytest

from audioflinger_hook.cli import doctor
from audioflinger_hook.doctor import reading
from audioflinger_hook.doctor.facts import Facts, Folder
from tests.doctor.test_findings import CASES
from tests.support.commands import call

JOURNAL = """\
2026-11-29T09:00:00+0000 cushion[12]: cushion: warning: the first of six
2026-11-29T09:00:01+0000 cushion[12]: cushion: warning: a; b
2026-11-29T09:00:02+0000 cushion[12]: cushion: running
2026-11-29T09:00:02+0000 cushion[12]: cushion: warning: c
2026-11-29T09:00:03+0000 cushion[12]: cushion: error: d: e
2026-11-29T09:00:04+0000 systemd[1]: cushion.service: Failed with result 'exit-code'.
2026-11-29T09:00:05+0000 systemd[1]: Started cushion.service - Haptic Cushion: error: none.
2026-11-29T09:00:06+0000 python[13]: cushion: error: f
"""


@pytest.mark.parametrize(("state", "count"), [("failed", 5), ("", 0)])
def test_the_last_errors_of_a_known_service_are_read(tmp_path, monkeypatch, state, count):
    (tmp_path / "journal").write_text(JOURNAL)
    for name, does in (("systemctl", f"echo {state}"), ("journalctl", f"cat {tmp_path}/journal")):
        (tmp_path / name).write_text(f"#!/bin/sh\n{does}\n")
        (tmp_path / name).chmod(0o700)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    home = {"HOME": str(tmp_path), "XDG_RUNTIME_DIR": str(tmp_path)}
    found = reading._with_daemon(Facts(), float, home)
    assert (found.service, len(found.errors)) == (state, count)
    if count:
        assert found.errors[0] == "2026-11-29T09:00:01+0000 cushion: warning: a; b"
        assert [one[25:] for one in found.errors[-2:]] == [
            "cushion.service: Failed with result 'exit-code'.", "cushion: error: f"
        ]  # fmt: skip


@pytest.mark.parametrize("shape", [[], ["--json"]])
def test_a_report_that_cannot_be_written_hides_neither_finding_nor_repair(
    tmp_path, monkeypatch, shape
):
    muted = replace(CASES["device-muted"], errors=("cushion: error: x",))
    monkeypatch.setattr(doctor, "read_facts", lambda *_: muted)
    monkeypatch.setattr(doctor, "repair", lambda *_: "it stays muted.")
    done = call("doctor", "--fix", "--report", tmp_path / "no" / "report.txt", *shape)
    assert done.code == 2
    assert "report.txt" in done.stderr
    assert "is muted, at volume 100 %" in done.stdout
    assert "it stays muted." in done.stdout
    if shape:
        facts = json.loads(done.stdout)["facts"]
        assert {"label": "last error", "text": "cushion: error: x"} in facts


def runtime_folder(home, **variables: str) -> Folder:
    folders = reading._machine({"HOME": str(home), **variables}).folders
    return next(one for one in folders if one.what == "runtime")


def test_a_folder_that_the_daemon_makes_may_be_missing_but_not_the_system_s(tmp_path, monkeypatch):
    found = runtime_folder(tmp_path, XDG_RUNTIME_DIR=str(tmp_path))
    assert (found.path, found.problem) == (str(tmp_path / "cushion"), "")
    assert found.free_bytes > 0
    found = runtime_folder(tmp_path, XDG_RUNTIME_DIR=str(tmp_path / "run"))
    assert (found.path, "XDG_RUNTIME_DIR" in found.problem) == (str(tmp_path / "run"), True)
    # Without a runtime folder of the system a temporary one is used.
    monkeypatch.setattr("os.geteuid", lambda: 4_000_000)  # this user has no /run/user/UID
    found = runtime_folder(tmp_path, TMPDIR=str(tmp_path))
    assert (found.path, found.problem) == (str(tmp_path / "cushion-4000000"), "")
