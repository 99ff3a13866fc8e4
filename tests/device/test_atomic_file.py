"""Files appear whole under their name, or not at all."""

import contextlib
import errno
import os
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from device.atomic_file import AtomicFile, make_private_folder, write_bytes_atomically
from device.errors import UsageError, WriteError
from tests.support.commands import listing, open_files
from tests.support.recordings import ROOT


@pytest.fixture(params=["nameless", "named"])
def way(request, monkeypatch):
    """Both ways to hold a file back: without a name, and under a hidden one."""
    if request.param == "named":
        monkeypatch.delattr(os, "O_TMPFILE", raising=False)
    elif not hasattr(os, "O_TMPFILE"):
        pytest.skip("files without a name exist on Linux only")
    return request.param


@pytest.fixture(params=[{}, {"out.wav": b"old"}], ids=["new", "old"])
def before(request, tmp_path):
    for name, content in request.param.items():
        (tmp_path / name).write_bytes(content)
    return request.param


def test_the_file_appears_with_commit_only(tmp_path, way, before):
    file = AtomicFile(tmp_path / "out.wav")
    for part in (b"new ", b"content"):
        file.write(part)
    if way == "nameless":
        assert listing(tmp_path) == before
    file.commit()
    assert listing(tmp_path) == {"out.wav": b"new content"}


def test_an_exception_leaves_the_folder_as_it_was(tmp_path, way, before):
    file = AtomicFile(tmp_path / "out.wav")

    def fail():
        with file:
            file.write(b"new")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert listing(tmp_path) == before
    file.abort()  # a second time is harmless
    with pytest.raises(WriteError, match="closed before"):
        file.commit()


def test_kill_9_leaves_the_folder_as_it_was(tmp_path):
    (tmp_path / "out.wav").write_bytes(b"old")
    script = (
        "import sys; from device.atomic_file import AtomicFile\n"
        "file = AtomicFile(sys.argv[1]); file.write(bytes(100_000))\n"
        "print('written', flush=True); sys.stdin.read()"
    )
    command, pipe = [sys.executable, "-c", script, str(tmp_path / "out.wav")], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, cwd=ROOT) as child:
        assert child.stdout
        assert child.stdout.readline() == b"written\n"
        child.kill()
    assert (child.returncode, listing(tmp_path)) == (-signal.SIGKILL, {"out.wav": b"old"})


def test_no_file_stays_open(tmp_path, way):
    open_before = open_files()
    write_bytes_atomically(tmp_path / "a", b"1")
    AtomicFile(tmp_path / "b").abort()
    with pytest.raises(UsageError):
        AtomicFile(tmp_path / "none" / "c")
    assert open_files() == open_before


def test_the_mode_is_what_the_umask_leaves(tmp_path, way):
    before = os.umask(0o027)
    try:
        write_bytes_atomically(tmp_path / "a", b"1")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664, 0o755])
def test_a_file_keeps_mode_owner_and_attributes_and_gives_them_to_a_copy(tmp_path, way, mode):
    path = tmp_path / "a"
    path.write_bytes(b"old")
    path.chmod(mode)
    owner = (1234, 4321) if os.geteuid() == 0 else (os.geteuid(), os.getegid())
    os.chown(path, *owner)
    with contextlib.suppress(OSError):  # not every file system has them
        os.setxattr(path, "user.note", b"mine")
    noted = os.listxattr(path)
    write_bytes_atomically(path, b"new")
    write_bytes_atomically(tmp_path / "copy", b"old", path)
    for one in (path, tmp_path / "copy"):
        found = one.stat()
        assert (stat.S_IMODE(found.st_mode), (found.st_uid, found.st_gid)) == (mode, owner)
        assert os.listxattr(one) == noted


def test_a_link_is_followed_and_stays(tmp_path, way):
    (tmp_path / "real").mkdir()
    link = tmp_path / "link"
    link.symlink_to("real/file")
    for content in (b"first", b"second"):  # dangling, then not
        write_bytes_atomically(link, content)
        assert link.is_symlink()
        assert (tmp_path / "real/file").read_bytes() == content


def test_names_of_any_kind_and_the_greatest_length_work(tmp_path, way):
    for name in ["ü" * 127, "x" * 255, "a\nb", "-n", os.fsdecode(b"\xff")]:
        for content in (b"1", b"2"):
            write_bytes_atomically(tmp_path / name, content)
        assert (tmp_path / name).read_bytes() == b"2"


def test_a_relative_path_and_a_change_of_folder_go_together(tmp_path, way, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = AtomicFile("out.wav")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    file.commit()
    assert listing(tmp_path / "elsewhere") == {}
    assert (tmp_path / "out.wav").exists()


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("none/out.wav", "folder .*/none does not exist; create it"),
        ("file/out.wav", "file is not a folder"),
        ("folder", "is a folder; name a file in it"),
        ("fifo", "not a regular file"),
        ("/dev/null", "not a regular file"),
        ("x" * 256, "name is too long"),
        ("a\0b", "null"),
        ("/", "no file name"),
        ("loop", "symbolic links"),
    ],
)
def test_a_path_that_cannot_be_written_is_refused_with_the_reason(tmp_path, way, path, words):
    (tmp_path / "file").write_bytes(b"1")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(UsageError, match=words) as caught:
        AtomicFile(tmp_path / path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("step", ["fsync", "replace"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EIO])
def test_a_failure_at_the_end_leaves_the_old_file_only(tmp_path, way, monkeypatch, step, number):
    def fail(*args, **kwargs):
        assert (tmp_path / "out.wav").read_bytes() == b"old"
        raise OSError(number, os.strerror(number))

    (tmp_path / "out.wav").write_bytes(b"old")
    file = AtomicFile(tmp_path / "out.wav")
    file.write(b"new")
    monkeypatch.setattr(os, step, fail)
    with pytest.raises(WriteError, match=r"cannot write .*out\.wav: .*another folder"):
        file.commit()
    assert listing(tmp_path) == {"out.wav": b"old"}


def test_a_write_that_the_system_takes_in_pieces_is_whole(tmp_path, monkeypatch):
    real = os.write
    monkeypatch.setattr(os, "write", lambda fd, content: real(fd, content[:1_000]))
    content = bytes(range(256)) * 30
    write_bytes_atomically(tmp_path / "a", content)
    assert (tmp_path / "a").read_bytes() == content


@pytest.fixture
def folder_of_nobody():
    """A folder anyone may enter; where tests run as root, the rest runs as nobody."""
    as_root = os.geteuid() == 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for inside, mode in [("free", 0o777), ("closed", 0), ("read_only", 0o555)]:
            (folder / inside).mkdir()
            (folder / inside).chmod(mode)
        (folder / "free" / "protected").write_bytes(b"old")
        (folder / "free" / "protected").chmod(0o444)
        folder.chmod(0o755)
        if as_root:
            os.seteuid(65534)
        try:
            yield folder
        finally:
            if as_root:
                os.seteuid(0)
            (folder / "closed").chmod(0o755)


@pytest.mark.parametrize("name", ["read_only/a", "closed/a", "closed/none/a", "free/protected"])
def test_what_may_not_be_written_is_refused(folder_of_nobody, way, name):
    write_bytes_atomically(folder_of_nobody / "free" / "new", b"new")
    words = "write-protected" if "free" in name else "no permission to write in folder"
    with pytest.raises(UsageError, match=words):
        AtomicFile(folder_of_nobody / name)


def test_a_folder_that_vanishes_is_a_write_error(tmp_path, way):
    (tmp_path / "folder").mkdir()
    file = AtomicFile(tmp_path / "folder/out.wav")
    shutil.rmtree(tmp_path / "folder")
    with pytest.raises(WriteError, match=r"out\.wav"):
        file.commit()


@pytest.mark.parametrize("name", ["file", "file/folder"])
def test_a_file_in_the_place_of_a_folder_is_named_with_what_to_do(tmp_path, name):
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="rename or remove the file in its place"):
        make_private_folder(tmp_path / name)
