"""The runtime folder of the daemon: whether it can be used, and why not."""

from pathlib import Path

import pytest

from audioflinger_hook.doctor.facts import Folder
from audioflinger_hook.doctor.reading import _machine


def runtime_folder(home: Path, **variables: str) -> Folder:
    folders = _machine({"HOME": str(home), **variables}).folders
    return next(one for one in folders if one.what == "runtime")


def test_a_folder_that_the_daemon_makes_may_be_missing_but_not_the_system_s(
    tmp_path: Path,
) -> None:
    found = runtime_folder(tmp_path, XDG_RUNTIME_DIR=str(tmp_path))
    assert (found.path, found.problem) == (str(tmp_path / "cushion"), "")
    assert found.free_bytes > 0
    found = runtime_folder(tmp_path, XDG_RUNTIME_DIR=str(tmp_path / "run"))
    assert (found.path, "XDG_RUNTIME_DIR" in found.problem) == (str(tmp_path / "run"), True)


def test_without_a_runtime_folder_of_the_system_a_temporary_one_is_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 4_000_000)  # this user has no /run/user/UID
    found = runtime_folder(tmp_path, TMPDIR=str(tmp_path))
    assert (found.path, found.problem) == (str(tmp_path / "cushion-4000000"), "")
