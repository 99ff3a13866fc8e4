import json
import os
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from audioflinger_hook.service.runtime_folder import LOCK_NAME, DaemonLock, Holder, RuntimeFolder
from device.errors import NotFoundError, UsageError
from tests.support.commands import environment, open_files

ME = Holder(os.getpid(), "2024-05-01 12:00:00", "sink:Cushion")
HOLD = """
import os, sys
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.runtime_folder import DaemonLock, Holder
lock = DaemonLock(RuntimeFolder(os.environ, True), Holder(os.getpid(), "today", "hw:Card"))
print("held", flush=True)
sys.stdin.read()
"""

root_only = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")


@pytest.fixture
def environ(tmp_path):
    return {"XDG_RUNTIME_DIR": str(tmp_path)}


@pytest.fixture
def folder(environ):
    with RuntimeFolder(environ, create=True) as folder:
        yield folder


@contextmanager
def holding(environ: dict[str, str], program: str = HOLD) -> Iterator[Any]:
    """A program of its own that has said "held" and waits."""
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, env=environment(**environ), **pipes) as process:
        try:
            assert process.stdout
            assert process.stdout.readline() == "held\n"
            yield process
        finally:
            process.kill()


def test_the_folder_is_made_for_its_owner_alone_whatever_the_umask(environ, tmp_path):
    with pytest.raises(NotFoundError):
        RuntimeFolder(environ, create=False)
    assert list(tmp_path.iterdir()) == []  # who only asks makes none
    before = os.umask(0)
    try:
        RuntimeFolder(environ, create=True).close()
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "cushion").stat().st_mode) == 0o700
    RuntimeFolder(environ, create=True).close()  # one that is there is taken


@pytest.mark.parametrize("value", ["relative/path", "/no/such/folder", "/dev/null", "/\0"])
def test_a_runtime_dir_that_cannot_be_used_is_refused_with_what_to_set(value):
    with pytest.raises(UsageError, match=r"XDG_RUNTIME_DIR is .*; set it to a folder of your own"):
        RuntimeFolder({"XDG_RUNTIME_DIR": value}, create=True)


@pytest.mark.parametrize("variable", [{}, {"XDG_RUNTIME_DIR": ""}])
def test_without_the_variable_a_private_folder_for_temporary_files_serves(variable, tmp_path):
    if Path(f"/run/user/{os.geteuid()}").is_dir():
        pytest.skip("this user has a folder in /run/user")
    with RuntimeFolder({**variable, "TMPDIR": str(tmp_path)}, create=True) as folder:
        assert folder.path == tmp_path / f"cushion-{os.geteuid()}"
        assert stat.S_IMODE(folder.path.stat().st_mode) == 0o700
    with pytest.raises(UsageError, match="TMPDIR is '/none', which is not a folder"):
        RuntimeFolder({**variable, "TMPDIR": "/none"}, create=True)
    folder.path.chmod(0o755)
    with pytest.raises(UsageError, match="open to others"):
        RuntimeFolder({**variable, "TMPDIR": str(tmp_path)}, create=True)


def test_a_link_or_a_file_in_its_place_is_refused(environ, tmp_path):
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    place = tmp_path / "cushion"
    for make in (lambda: place.symlink_to("elsewhere"), place.touch):
        make()
        with pytest.raises(UsageError, match="is a link or not a folder; remove it"):
            RuntimeFolder(environ, create=True)
        place.unlink()


@pytest.mark.parametrize("mode", [0o777, 0o750, 0o701])
def test_a_folder_that_others_can_enter_is_refused(environ, tmp_path, mode):
    (tmp_path / "cushion").mkdir()
    (tmp_path / "cushion").chmod(mode)
    files = open_files()
    with pytest.raises(UsageError, match=f"open to others .mode 0{mode:o}.; allowed: 0700"):
        RuntimeFolder(environ, create=True)
    assert open_files() == files


@root_only
def test_a_folder_or_a_lock_file_of_somebody_else_is_refused(environ, tmp_path):
    with RuntimeFolder(environ, create=True) as folder:
        (folder.path / LOCK_NAME).touch()
        os.chown(folder.path / LOCK_NAME, 65534, 65534)
        with pytest.raises(UsageError, match="is not a file of user 0; remove it"):
            DaemonLock(folder, ME)
    os.chown(tmp_path / "cushion", 65534, 65534)
    with pytest.raises(UsageError, match="belongs to user 65534, not to 0; run as that user"):
        RuntimeFolder(environ, create=True)


def test_the_second_daemon_is_told_who_holds_the_lock(environ, folder):
    with holding(environ) as process, pytest.raises(UsageError) as caught:
        DaemonLock(folder, ME)
    assert str(caught.value) == (
        f"another cushion daemon is running (process {process.pid}, started today, device "
        "hw:Card); allowed: one per user; ask it with `cushion status`, or stop it first"
    )


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV, None])
def test_the_lock_is_free_after_any_death_of_its_holder(environ, folder, end):
    with holding(environ) as process:
        if end is None:
            process.stdin.close()
        else:
            process.send_signal(end)
        process.wait(10)
        with DaemonLock(folder, ME):
            pass


def test_a_released_lock_is_free_even_if_a_program_of_the_holder_runs_and_keeps_no_name(folder):
    path = folder.path / LOCK_NAME
    path.write_text("x" * 1000)  # of one who is long dead
    lock = DaemonLock(folder, ME)
    held = {"pid": ME.pid, "started": ME.started, "device": ME.device}
    assert (json.loads(path.read_text()), path.stat().st_mode & 0o777) == (held, 0o600)
    with subprocess.Popen(["cat"], stdin=subprocess.PIPE, close_fds=False) as child:
        for _ in range(2):
            lock.release()
        assert path.read_text() == ""
        with DaemonLock(folder, ME):
            assert child.poll() is None


@pytest.mark.parametrize(
    "content",
    ["", "x", '{"pid": -1}', '{"pid": 999999999999999999999, "started": "", "device": ""}'],
)
def test_a_holder_that_does_not_say_who_it_is_still_holds(folder, content):
    with DaemonLock(folder, ME):
        (folder.path / LOCK_NAME).write_text(content)
        with pytest.raises(UsageError, match="another cushion daemon is running; allowed"):
            DaemonLock(folder, ME)


def test_a_lock_file_that_was_removed_meanwhile_locks_nothing_and_is_made_anew(folder, monkeypatch):
    look: Callable[[str], os.stat_result | None] = folder.entry

    def gone_once(name: str) -> os.stat_result | None:
        monkeypatch.setattr(folder, "entry", look)
        (folder.path / LOCK_NAME).unlink()
        return look(name)

    monkeypatch.setattr(folder, "entry", gone_once)
    with DaemonLock(folder, ME):
        assert json.loads((folder.path / LOCK_NAME).read_text())["pid"] == ME.pid
        with pytest.raises(UsageError, match="another cushion daemon"):
            DaemonLock(folder, ME)


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo, lambda path: path.symlink_to("x")])
def test_what_is_no_file_of_ours_is_refused_at_once(folder, make):
    make(folder.path / LOCK_NAME)
    files = open_files()
    with pytest.raises(UsageError, match=r"; remove it$"):
        DaemonLock(folder, ME)
    assert open_files() == files
    assert not (folder.path / "x").exists()
