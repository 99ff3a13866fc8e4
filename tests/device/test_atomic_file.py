import contextlib
import errno
import os
import resource
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import soundfile
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import wavfile

from device.atomic_file import AtomicFile, make_private_folder, write_bytes_atomically
from device.errors import InternalError, UsageError, WriteError
from device.wav_output import WavOutput, wav_header
from tests.support.commands import listing, open_files
from tests.support.recordings import ROOT
from tests.support.taps import noise


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


def written(path, blocks, samplerate=48_000, channels=2, **options):
    output = WavOutput(path, samplerate, channels, **options)
    for block in blocks:
        output.write(block)
    output.close()
    return Path(path)


@pytest.mark.parametrize("channels", [1, 2, 5, 64])
@pytest.mark.parametrize("samplerate", [1_000, 44_100, 192_000])
def test_libsndfile_and_scipy_read_back_what_was_written(tmp_path, samplerate, channels):
    vibration = noise(1_000, channels)
    path = written(tmp_path / "a.wav", [vibration], samplerate, channels)
    info = soundfile.info(path)
    assert (info.format, info.subtype) == ("WAV", "FLOAT")
    for samples, rate in (soundfile.read(path, dtype="float32"), wavfile.read(path)[::-1]):
        assert rate == samplerate
        assert np.array_equal(samples.reshape(-1, channels), vibration.astype(np.float32))


@given(st.lists(st.integers(0, 50)), st.sampled_from([np.float32, np.float64]))
def test_equal_vibration_gives_equal_bytes_however_it_is_split(tmp_path_factory, sizes, dtype):
    folder = tmp_path_factory.mktemp("split")
    vibration = noise(sum(sizes)).astype(dtype)
    blocks = np.split(vibration, np.cumsum(sizes)[:-1]) if sizes else []
    split = written(folder / "split.wav", blocks)
    whole = written(folder / "whole.wav", [np.asfortranarray(vibration)])
    assert split.read_bytes() == whole.read_bytes()


@pytest.mark.parametrize("frames", [0, 3])
@pytest.mark.parametrize("comment", ["profile paper", "odd", "Grüße", ""])
def test_the_comment_is_the_files_comment(tmp_path, comment, frames):
    path = written(tmp_path / "a.wav", [noise(frames)], comment=comment)
    with soundfile.SoundFile(path) as file:
        assert (file.comment, file.frames) == (comment, frames)


@pytest.mark.parametrize("comment", [None, "long recording"])
def test_a_file_over_4_gb_is_rf64(tmp_path, comment):
    path = tmp_path / "long.wav"
    small, frames = 2**20, 2**30 + 5
    header = wav_header(48_000, 1, frames, comment)
    assert len(header) == len(wav_header(48_000, 1, small, comment))
    with path.open("wb") as file:
        file.write(header)
        file.truncate(len(header) + 4 * frames)  # a hole: takes no room on the disk
    info = soundfile.info(path)
    assert (info.format, info.subtype, info.frames) == ("RF64", "FLOAT", frames)


def test_the_last_frame_that_fits_a_wav_file_is_still_in_one(tmp_path):
    frames = (2**32 - 2 - (len(wav_header(48_000, 1, 0)) - 8)) // 4
    assert wav_header(48_000, 1, frames).startswith(b"RIFF")
    assert wav_header(48_000, 1, frames + 1).startswith(b"RF64")


@pytest.mark.parametrize(("samplerate", "channels"), [(0, 1), (48_000, 0), (48_000, 16_384)])
def test_what_a_header_cannot_say_is_refused_and_leaves_no_file(tmp_path, samplerate, channels):
    with pytest.raises(InternalError, match="samplerate="):
        WavOutput(tmp_path / "a.wav", samplerate, channels)
    assert list(tmp_path.iterdir()) == []


def test_a_block_of_another_shape_is_refused(tmp_path):
    output = WavOutput(tmp_path / "a.wav", 48_000, 2)
    for shape in [(10,), (10, 3), (10, 2, 1)]:
        with pytest.raises(InternalError, match="shape"):
            output.write(np.zeros(shape))
    output.abort()


def test_the_first_of_close_and_abort_counts(tmp_path):
    for name in ("close", "abort"):
        output = WavOutput(tmp_path / name, 48_000, 2)
        for ending in (getattr(output, name), output.abort, output.close):
            ending()
        with pytest.raises(InternalError, match="closed"):
            output.write(noise(1))
    assert [path.name for path in tmp_path.iterdir()] == ["close"]


def test_memory_stays_flat(tmp_path):
    block = noise(10_000).astype(np.float32)
    output = WavOutput(tmp_path / "a.wav", 48_000, 2)
    output.write(block)
    tracemalloc.start()
    for _ in range(100):
        output.write(block)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    output.close()
    assert peak < block.nbytes  # of 100 times that


# Reached within the header, between two blocks, within a block.
@pytest.mark.sweep
@pytest.mark.parametrize("limit", [50, len(wav_header(48_000, 2, 0)) + 26 * 3_840, 1_000_001])
def test_a_file_size_limit_is_a_write_error_and_leaves_no_file(tmp_path, limit):
    (tmp_path / "a.wav").write_bytes(b"old")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        with pytest.raises(WriteError, match=r"than allowed; raise the limit \(ulimit -f\)"):
            written(tmp_path / "a.wav", [np.zeros((480, 2))] * 2_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert listing(tmp_path) == {"a.wav": b"old"}


def test_a_disk_that_fills_up_is_a_write_error_and_keeps_the_old_file(small_disk):
    (small_disk / "a.wav").write_bytes(b"old")
    output = WavOutput(small_disk / "a.wav", 48_000, 2)

    def fill():
        for _ in range(1_000):
            output.write(noise(480))

    with pytest.raises(WriteError, match="disk is full"):
        fill()
    output.close()  # has nothing left to finish
    assert listing(small_disk) == {"a.wav": b"old"}
    assert os.statvfs(small_disk).f_bavail >= 6  # of 8 blocks: the room is free again


def test_a_file_that_is_not_as_long_as_it_must_be_is_discarded(tmp_path, monkeypatch):
    output = WavOutput(tmp_path / "a.wav", 48_000, 2)
    output.write(noise(480))
    monkeypatch.setattr("device.atomic_file.AtomicFile.size", lambda file: 1_000)
    with pytest.raises(WriteError, match="1000 of 39"):
        output.close()
    assert list(tmp_path.iterdir()) == []
