"""The private ALSA configuration lies where nobody else reads it, and nothing of it stays."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from device.errors import UsageError
from device.stream.pcms import PREFIX, PcmConfig, PrivateDir, remove_stale, runtime_dir
from tests.support.recordings import ROOT

HOLDER = """
import sys, time
from device.stream.pcms import PcmConfig
config = PcmConfig("one")
print("held", flush=True)
time.sleep(60)
"""


def inside(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_it_is_made_in_the_runtime_folder_for_us_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    config = PcmConfig("one")
    path = Path(os.environ["ALSA_CONFIG_PATH"])
    assert path.parent.parent == tmp_path / "cushion"
    assert [stat.S_IMODE(p.stat().st_mode) for p in (path.parent, path.parent.parent)] == [
        0o700
    ] * 2
    config.close()
    config.close()
    assert inside(tmp_path / "cushion") == []


@pytest.mark.parametrize("kind", ["unset", "relative", "missing", "blank", "colon", "open", "link"])
def test_where_there_is_no_such_folder_the_temporary_one_serves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    base = tmp_path / {"blank": "a b", "colon": "a:b"}.get(kind, "base")
    if kind != "missing":
        base.mkdir()
    if kind == "open":
        (base / "cushion").mkdir(mode=0o755)
    if kind == "link":
        (base / "cushion").symlink_to(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", {"relative": "base"}.get(kind, str(base)))
    if kind == "unset":
        monkeypatch.delenv("XDG_RUNTIME_DIR")
    spare = tmp_path / "spare"
    spare.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(spare))
    assert runtime_dir() is None
    folder = PrivateDir()
    assert folder.path.parent == spare
    folder.close()
    assert inside(spare) == []


def test_what_killed_processes_left_is_swept_and_what_is_in_use_is_not(tmp_path: Path) -> None:
    def started() -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-c", HOLDER],
            env=os.environ | {"XDG_RUNTIME_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        return process

    place = tmp_path / "cushion"
    with started() as living:
        try:
            with started() as killed:
                assert len(inside(place)) == 2
                killed.send_signal(signal.SIGKILL)
            (place / "daemon.lock").touch()
            (place / f"{PREFIX}file").touch()
            (place / f"{PREFIX}link").symlink_to(tmp_path)
            assert remove_stale(place) == 1
            names = inside(place)
            assert len([name for name in names if (place / name).is_dir()]) == 2  # with the link
            assert {"daemon.lock", f"{PREFIX}file", f"{PREFIX}link"} < set(names)
            assert remove_stale(place) == 0
            folder = PrivateDir(place)
            assert len(inside(place)) == len(names) + 1
            folder.close()
            assert inside(place) == names
        finally:
            living.kill()
    assert remove_stale(place) == 1
    assert remove_stale(tmp_path / "nowhere") == 0


def test_a_folder_that_cannot_be_made_is_an_error_of_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="set XDG_RUNTIME_DIR or TMPDIR"):
        PrivateDir(tmp_path / "file")
