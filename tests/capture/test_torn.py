"""Captures that were cut off or damaged: every whole buffer is read, and none that is not."""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import random
import shutil
import signal
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.capture import Capture, CaptureWriter
from audioflinger_hook.capture.format import (
    INDEX_NAME,
    SAMPLES_OFFSET,
    BufferRecord,
    DroppedRecord,
    EndRecord,
    Header,
    parse_line,
    records,
)
from device.errors import UsageError, WriteError
from device.values import counted
from tests.support.recordings import ROOT

STREAMS = ("tap", "effect")

# stream, frames, samplerate, channels
SMALL = [
    ("tap", 3, 48_000, 2),
    ("effect", 3, 48_000, 1),
    ("tap", 0, 48_000, 2),
    ("tap", 2, 48_000, 2),
    ("effect", 2, 48_000, 1),
    ("tap", 4, 44_100, 1),
    ("tap", 0, 44_100, 1),
    ("tap", 1, 44_100, 1),
    ("effect", 5, 48_000, 1),
]


@functools.cache
def samples_of(number, frames, channels):
    noise = np.random.default_rng(number).standard_normal((frames, channels))
    return noise.astype(np.float32)


def deliver(writer, number):
    stream, frames, samplerate, channels = SMALL[number]
    writer.write_buffer(stream, samples_of(number, frames, channels), samplerate, float(number))


def expected(numbers, stream):
    """What a reader must give for these of SMALL."""
    return [
        (number, SMALL[number][2], samples_of(number, *SMALL[number][1::2]).tobytes())
        for number in numbers
        if SMALL[number][0] == stream
    ]


def found(buffers):
    return [(buffer.time_s, buffer.samplerate, buffer.frames.tobytes()) for buffer in buffers]


def read(folder, stream):
    capture = Capture(folder)
    buffers = list(capture.buffers(stream)) if stream in capture.streams else []
    return buffers, capture.warnings


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A capture of SMALL as kill -9 would leave it: never closed."""
    folder = tmp_path_factory.mktemp("small")
    writer = CaptureWriter(folder, streams=STREAMS)
    for number in range(len(SMALL)):
        deliver(writer, number)
    killed = folder.parent / "killed"
    shutil.copytree(folder, killed)
    writer.close()
    return killed


@pytest.fixture
def damaged(small, tmp_path):
    """A copy of `small` to be damaged."""
    return Path(shutil.copytree(small, tmp_path / "damaged"))


# ------------------------------------------------------------------------ cut at every byte offset


def end_of_each_buffer(folder, name):
    """Return the length that a file must have for each buffer of SMALL to be whole."""
    if name == INDEX_NAME:
        header, *lines = (folder / name).read_bytes().splitlines()
        after = np.cumsum([len(line) + 1 for line in (header, *lines)])[1:]
        return dict(enumerate(after - 1))  # a line is whole without its line break
    ends, end = {}, SAMPLES_OFFSET
    rate = 44_100 if name[-5] == "2" else 48_000
    for number, (stream, frames, samplerate, channels) in enumerate(SMALL):
        if (stream, samplerate) == (name[:-9], rate):
            end += 4 * frames * channels
            ends[number] = end
    return ends


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(INDEX_NAME, marks=pytest.mark.exhaustive),
        *("tap-0001.wav", "tap-0002.wav", "effect-0001.wav"),
    ],
)
def test_a_file_cut_anywhere_gives_the_buffers_that_are_whole(damaged, name):
    ends = end_of_each_buffer(damaged, name)
    shortest = len((damaged / name).read_bytes().splitlines()[0]) if name == INDEX_NAME else 0
    for size in range((damaged / name).stat().st_size, shortest - 1, -1):
        os.truncate(damaged / name, size)
        stream = STREAMS[size % 2] if name == INDEX_NAME else name[:-9]
        whole = [n for n in range(len(SMALL)) if ends.get(n, 0) <= size]
        buffers, warnings = read(damaged, stream)
        assert found(buffers) == expected(whole, stream)
        frames = sum(len(buffer.frames) for buffer in buffers)
        recovered = f"{counted(len(buffers), 'whole buffers')} ({frames} frames) of stream {stream}"
        assert recovered in warnings[-1]
        # Only the first buffer after a gap is a discontinuity.
        mine = [n for n, entry in enumerate(SMALL) if entry[0] == stream]
        before = dict(zip(mine[1:], mine, strict=False))
        after_gap = [n for n in mine if n in whole and before.get(n, n) not in [*whole, n]]
        assert [int(buffer.time_s) for buffer in buffers if buffer.discontinuity] == after_gap


@given(st.data())
@settings(max_examples=60)
def test_index_and_segments_cut_together_give_a_sound_beginning(small, tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("cut") / "c"
    shutil.copytree(small, folder)
    first_line = len((folder / INDEX_NAME).read_bytes().splitlines()[0])
    for path in sorted(folder.iterdir()):
        least = first_line if path.name == INDEX_NAME else 0
        os.truncate(path, data.draw(st.integers(least, path.stat().st_size)))
    for stream in STREAMS:
        buffers, warnings = read(folder, stream)
        kept = [int(buffer.time_s) for buffer in buffers]
        assert found(buffers) == expected(kept, stream)
        assert kept == sorted(set(kept))
        assert any("was cut off" in text for text in warnings)


# --------------------------------------------------------------------- writes that fail half-way


def record(folder, acknowledged, ignored=()):
    with CaptureWriter(folder, streams=STREAMS) as writer:
        for number in range(len(SMALL)):
            with contextlib.suppress(*ignored):
                deliver(writer, number)
                acknowledged.append(number)


class Killed(BaseException):
    """Stands for kill -9: nothing that comes later reaches the disk."""


def after_every_write(tmp_path, monkeypatch, error, share, ignored=()):
    """Record SMALL with an error in the first, second, ... write, of which a share is written.

    After `Killed`, nothing more is written. A full disk fails in every later write as well. Yield
    folder, acknowledged buffers, and what was raised, until no write is left to fail.
    """
    pwrite = os.pwrite
    for call in range(1_000):
        left, acknowledged, raised = [call], list[int](), None

        def write(fd, content, position, left=left):
            left[0] -= 1
            if left[0] >= 0 or (left[0] < -1 and isinstance(error, KeyboardInterrupt)):
                return pwrite(fd, content, position)
            if left[0] == -1:
                pwrite(fd, bytes(content)[: round(len(content) * share)], position)
            elif isinstance(error, Killed):
                return len(content)
            raise error

        with monkeypatch.context() as patched:
            patched.setattr(os, "pwrite", write)
            if isinstance(error, Killed):
                patched.setattr(os, "ftruncate", lambda fd, size: None)
                patched.setattr(Path, "unlink", lambda path: None)
            try:
                record(tmp_path / str(call), acknowledged, ignored)
            except (Killed, KeyboardInterrupt, WriteError) as one:
                raised = one
        if left[0] >= 0:
            break
        yield tmp_path / str(call), acknowledged, raised
    assert call > 3 * len(SMALL)


SHARES = pytest.mark.parametrize("share", [0.0, 0.5, 1.0])


@SHARES
def test_killed_at_any_moment_at_most_the_buffer_being_written_is_lost(
    tmp_path, monkeypatch, share
):
    for folder, acknowledged, _ in after_every_write(tmp_path, monkeypatch, Killed(), share):
        if not folder.is_dir() or folder.name == "0":
            continue  # killed while beginning
        for stream in STREAMS:
            buffers, warnings = read(folder, stream)
            with_last = range(min(len(acknowledged) + 1, len(SMALL)))
            assert found(buffers) in (expected(acknowledged, stream), expected(with_last, stream))
            assert not any(buffer.discontinuity for buffer in buffers)
            assert not warnings or ["was cut off" in text for text in warnings] == [True]
            assert warnings or len(acknowledged) == len(SMALL)


@SHARES
def test_a_write_that_fails_anywhere_leaves_exactly_what_was_acknowledged(
    tmp_path, monkeypatch, share
):
    full = OSError(errno.ENOSPC, "No space left on device")
    for folder, acknowledged, raised in after_every_write(tmp_path, monkeypatch, full, share):
        assert "the disk is full" in str(raised)
        if folder.name == "0":
            assert not folder.exists()
            continue
        for stream in STREAMS:
            buffers, warnings = read(folder, stream)
            assert found(buffers) == expected(acknowledged, stream)
            assert ["was cut off" in text for text in warnings] == [True]
        for path in folder.glob("*.wav"):
            assert (path.stat().st_size - SAMPLES_OFFSET) % 4 == 0


@SHARES
def test_an_interruption_anywhere_takes_that_buffer_and_no_other(tmp_path, monkeypatch, share):
    stop = KeyboardInterrupt()
    runs = after_every_write(tmp_path, monkeypatch, stop, share, ignored=[KeyboardInterrupt])
    for folder, kept, raised in runs:
        if raised:  # in the first line or in the last
            continue
        assert len(kept) == len(SMALL) - 1
        for stream in STREAMS:
            buffers, warnings = read(folder, stream)
            assert (found(buffers), warnings) == (expected(kept, stream), [])


SCRIPT = """
import sys
import numpy as np
from audioflinger_hook.capture import CaptureWriter
writer = CaptureWriter(sys.argv[1], streams=("tap", "effect"))
for number in range(1_000_000):
    frames = np.full((number % 700, 2), number, np.float32)
    writer.write_buffer("tap", frames, 48_000 + number // 50, number / 100)
    writer.write_buffer("effect", frames[:, :1], 48_000, number / 100)
    print(number, flush=True)
"""


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(5))
def test_kill_9_loses_nothing_that_was_acknowledged(tmp_path, seed):
    command = [sys.executable, "-c", SCRIPT, str(tmp_path / "c")]
    least = random.Random(seed).randrange(1, 600)
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT) as child:
        assert child.stdout
        while int(child.stdout.readline()) < least:
            pass
        child.kill()
        acknowledged = least
        for line in child.stdout:
            if line.endswith(b"\n"):
                acknowledged = int(line)
    assert child.returncode == -signal.SIGKILL
    for stream, channels in [("tap", 2), ("effect", 1)]:
        capture = Capture(tmp_path / "c")
        number = -1
        for number, buffer in enumerate(capture.buffers(stream)):
            assert buffer.time_s == number / 100
            assert buffer.frames.shape == (number % 700, channels)
            assert not buffer.discontinuity
            assert np.all(buffer.frames == number)
        assert number in (acknowledged, acknowledged + 1)
        (warning,) = capture.warnings
        assert counted(number + 1, "whole buffers") in warning
        for path in (tmp_path / "c").glob(f"{stream}-*.wav"):
            if path.stat().st_size > SAMPLES_OFFSET:
                soundfile.read(path)  # a player takes it


def test_after_a_failure_the_writer_is_done(tmp_path, monkeypatch):
    writer = CaptureWriter(tmp_path, streams=STREAMS)
    deliver(writer, 0)
    with monkeypatch.context() as patched:
        patched.setattr(os, "pwrite", fail_with(errno.EIO))
        with pytest.raises(WriteError, match="name another folder; it can be replayed up to there"):
            deliver(writer, 1)
    with pytest.raises(WriteError, match="replayed up to there"):
        deliver(writer, 2)
    with pytest.raises(WriteError, match="replayed up to there"):
        writer.note_dropped("tap", 1, 1)
    writer.close()
    assert found(read(tmp_path, "tap")[0]) == expected([0], "tap")
    assert not list(Path("/proc/self/fd").glob(f"*{tmp_path.name}*"))


def fail_with(number):
    def fail(*_args):
        raise OSError(number, os.strerror(number))

    return fail


def test_a_disk_that_fails_at_the_end_is_told(tmp_path, monkeypatch):
    writer = CaptureWriter(tmp_path, streams=STREAMS)
    deliver(writer, 0)
    monkeypatch.setattr(os, "fsync", fail_with(errno.EIO))
    with pytest.raises(WriteError, match="cannot write to the capture"):
        writer.close()
    buffers, warnings = read(tmp_path, "tap")
    assert found(buffers) == expected([0], "tap")
    assert "was cut off" in warnings[0]


def test_short_writes_are_continued(tmp_path, monkeypatch):
    pwrite = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda fd, content, at: pwrite(fd, bytes(content)[:3], at))
    record(tmp_path / "c", [])
    for stream in STREAMS:
        buffers, warnings = read(tmp_path / "c", stream)
        assert (found(buffers), warnings) == (expected(range(len(SMALL)), stream), [])


LIMITED = """
import resource, sys
import numpy as np
from audioflinger_hook.capture import CaptureWriter
from device.errors import WriteError
from device.values import counted
limit, frames = int(sys.argv[2]), int(sys.argv[3])
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
number = 0
try:
    with CaptureWriter(sys.argv[1]) as writer:
        for number in range(2_000):
            writer.write_buffer("tap", np.full((frames, 2), number, np.float32), 48_000, 0.0)
except WriteError as error:
    print(number, error)
    sys.exit(error.exit_code)
"""


# Reached within a segment's samples, between two buffers, within the index.
@pytest.mark.sweep
@pytest.mark.parametrize(
    ("limit", "frames"), [(100_003, 480), (SAMPLES_OFFSET + 26 * 3_840, 480), (50_000, 1)]
)
def test_a_file_size_limit_is_a_write_error_and_the_capture_can_be_read(tmp_path, limit, frames):
    command = [sys.executable, "-c", LIMITED, str(tmp_path / "c"), str(limit), str(frames)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == WriteError.exit_code == 5
    number, message = done.stdout.split(" ", 1)
    assert "larger than allowed; raise the limit (ulimit -f)" in message
    buffers, warnings = read(tmp_path / "c", "tap")
    assert [float(buffer.frames[0, 0]) for buffer in buffers] == list(range(int(number)))
    assert counted(int(number), "whole buffers") in warnings[0]


def test_a_limit_too_small_to_begin_leaves_no_folder(tmp_path):
    command = [sys.executable, "-c", LIMITED, str(tmp_path / "c"), "10", "1"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == WriteError.exit_code
    assert list(tmp_path.iterdir()) == []


# --------------------------------------------------------------------------- damage in the middle


@contextlib.contextmanager
def flipped(path, offset):
    """One bit of the file is wrong, for a while; another one at every offset."""

    def flip():
        with path.open("r+b", buffering=0) as file:
            file.seek(offset)
            byte = file.read(1)[0]
            file.seek(offset)
            file.write(bytes([byte ^ 1 << offset % 8]))

    flip()
    yield
    flip()


@pytest.mark.exhaustive
def test_any_damaged_byte_of_the_index_costs_at_most_the_buffers_of_its_lines(damaged):
    index = damaged / INDEX_NAME
    for offset in range(index.stat().st_size):
        with flipped(index, offset):
            stream = STREAMS[offset // 8 % 2]
            buffers, warnings = read(damaged, stream)
        everything = expected(range(len(SMALL)), stream)
        kept = [everything.index(buffer) for buffer in found(buffers)]
        assert len(kept) >= len(everything) - 2
        before = [-1, *kept]
        gaps = [number for number, last in zip(kept, before, strict=False) if number > last + 1]
        marked = [n for n, buffer in zip(kept, buffers, strict=True) if buffer.discontinuity]
        assert marked == gaps
        assert any("damaged and left out" in text for text in warnings) == bool(gaps)


def test_lines_that_vanish_or_are_overwritten_are_a_gap_with_a_warning(damaged):
    index = damaged / INDEX_NAME
    lines = index.read_bytes().splitlines(keepends=True)
    for replacement in [b"", b"\0" * 400, b"\n\n", b"x" * 200_000 + b"\n", b'{"kind":1}\n']:
        index.write_bytes(b"".join([*lines[:3], replacement, *lines[5:]]))
        buffers, warnings = read(damaged, "tap")
        kept = [0, 1, 4, 5, 6, 7, 8]
        if replacement.startswith(b"\0"):  # has no line break: takes the next line along
            kept.remove(4)
        assert found(buffers) == expected(kept, "tap")
        assert [buffer.discontinuity for buffer in buffers] == [False, True, False, False]
        assert "damaged and left out: 2 buffers of stream tap" in warnings[0]
        assert "first before buffer 3" in warnings[0]


def test_a_line_that_is_too_long_is_one_damaged_line(tmp_path):
    (tmp_path / INDEX_NAME).write_bytes(b"x" * 500_000 + b"\n" + EndRecord({}).line())
    assert list(records(tmp_path / INDEX_NAME)) == [None, EndRecord({})]


WHOLE = BufferRecord("tap", 0, 1, 0, 3, 48_000, 2, 0.0, False, "00000000")
END, DROPPED, HEADER = EndRecord({"tap": 1}), DroppedRecord("tap", 1, 0), Header(streams=["tap"])


@pytest.mark.parametrize(
    ("record", "name", "value"),
    [
        *((WHOLE, name, -1) for name in ("buffer", "first", "frames")),
        *((WHOLE, name, 0) for name in ("segment", "samplerate", "channels", "time_s")),
        *((WHOLE, "stream", 1), (WHOLE, "discontinuity", 1), (WHOLE, "frames", True)),
        *((DROPPED, "frames", -1), (END, "buffers", {"tap": -1}), (END, "buffers", {"tap": True})),
        *((HEADER, "streams", [1]), (HEADER, "facts", {"x": [1]})),
    ],
)
def test_a_line_with_a_value_that_no_recorder_writes_is_damaged(
    record: Any, name: str, value: object
) -> None:
    assert parse_line(record.line()) == record
    assert parse_line(replace(record, **{name: value}).line()) is None


def test_a_damaged_first_line_costs_no_buffer(damaged):
    index = damaged / INDEX_NAME
    content = index.read_bytes()
    index.write_bytes(b"?" + content[1:])
    for stream in STREAMS:
        buffers, warnings = read(damaged, stream)
        assert found(buffers) == expected(range(len(SMALL)), stream)
        assert "first line is damaged; version 1 is assumed" in warnings[0]


def test_changed_samples_are_not_given_as_those_recorded(damaged):
    path = damaged / "tap-0001.wav"
    for offset in range(path.stat().st_size):
        with flipped(path, offset):
            buffers, warnings = read(damaged, "tap")
        changed = None
        if offset >= SAMPLES_OFFSET:
            changed = 0 if offset < SAMPLES_OFFSET + 24 else 3
        kept = [number for number in range(len(SMALL)) if number != changed]
        assert found(buffers) == expected(kept, "tap")
        marked = [buffer.time_s for buffer in buffers if buffer.discontinuity]
        assert marked == {None: [], 0: [2.0], 3: [5.0]}[changed]
        assert len(warnings) == (1 if changed is None else 2)


def test_a_missing_segment_is_a_gap_with_a_warning(damaged):
    (damaged / "tap-0001.wav").unlink()
    buffers, warnings = read(damaged, "tap")
    assert found(buffers) == expected([5, 6, 7], "tap")
    assert [buffer.discontinuity for buffer in buffers] == [True, False, False]
    assert "damaged and left out: 3 buffers of stream tap" in warnings[0]


def test_a_missing_last_segment_of_a_closed_capture_is_told(tmp_path):
    record(tmp_path / "c", [])
    (tmp_path / "c" / "tap-0002.wav").unlink()
    buffers, warnings = read(tmp_path / "c", "tap")
    assert found(buffers) == expected([0, 2, 3], "tap")
    (warning,) = warnings
    assert "damaged at the end: 3 buffers; recovered: 3 whole buffers (5 frames)" in warning
    assert read(tmp_path / "c", "effect")[1] == []


def test_a_folder_or_a_pipe_in_place_of_a_segment_is_refused(damaged):
    path = damaged / "tap-0001.wav"
    for make in (Path.mkdir, os.mkfifo):
        path.unlink() if path.is_file() else path.rmdir()
        make(path)
        with pytest.raises(UsageError, match=r"tap-0001.wav is not a file"):
            read(damaged, "tap")


def test_a_huge_index_without_line_breaks_takes_no_memory(tmp_path):
    (tmp_path / INDEX_NAME).write_bytes(b'{"kind"' * 2_000_000)
    tracemalloc.start()
    with pytest.raises(UsageError, match="not a capture"):
        Capture(tmp_path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000


# ------------------------------------------------------------------------------- without an index


@pytest.mark.parametrize("index", [None, b"", b'{"kind":"capture","for', b"\0" * 5_000])
def test_without_an_index_the_segments_are_read_in_order_with_a_warning(damaged, index):
    (damaged / INDEX_NAME).unlink()
    if index is not None:
        (damaged / INDEX_NAME).write_bytes(index)
    buffers, warnings = read(damaged, "tap")
    formats = [(len(buffer.frames), buffer.samplerate, buffer.channels) for buffer in buffers]
    assert formats == [(5, 48_000, 2), (5, 44_100, 1)]
    assert [buffer.time_s for buffer in buffers] == [0.0, 5 / 48_000]
    whole = b"".join(content for _, _, content in expected(range(len(SMALL)), "tap"))
    assert b"".join(buffer.frames.tobytes() for buffer in buffers) == whole
    (warning,) = warnings
    assert "buffers of 1024 frames from time 0 on" in warning
    assert "sizes, times and discontinuities are not those recorded" in warning


def test_without_an_index_long_segments_come_in_buffers_of_the_stated_size(tmp_path):
    with CaptureWriter(tmp_path) as writer:
        writer.write_buffer("tap", samples_of(1, 2_500, 1), 1_000, 77.0)
    (tmp_path / INDEX_NAME).unlink()
    buffers, _ = read(tmp_path, "tap")
    assert [(len(buffer.frames), buffer.time_s) for buffer in buffers] == [
        (1_024, 0.0),
        (1_024, 1.024),
        (452, 2.048),
    ]


def test_without_an_index_a_torn_last_segment_ends_with_its_last_whole_buffer(damaged):
    (damaged / INDEX_NAME).unlink()
    with (damaged / "tap-0002.wav").open("ab") as file:
        file.write(bytes(11))  # a piece of a buffer: two frames and a bit
    (damaged / "tap-0003.wav").write_bytes(b"RIFF")  # and a segment that had hardly begun
    buffers, _ = read(damaged, "tap")
    assert [len(buffer.frames) for buffer in buffers] == [5, 5]


def test_without_an_index_a_missing_segment_is_refused_as_ambiguous(damaged):
    (damaged / INDEX_NAME).unlink()
    (damaged / "tap-0001.wav").unlink()
    with pytest.raises(UsageError, match=r"lost index.jsonl and tap-0001.wav: .* one by one"):
        read(damaged, "tap")
    assert len(read(damaged, "effect")[0]) == 1  # that one is whole


def test_without_an_index_a_segment_of_no_capture_is_refused_and_not_guessed(damaged):
    def refused(name):
        with pytest.raises(UsageError, match=rf"{name} is not as a capture writes it"):
            read(damaged, "tap")

    (damaged / INDEX_NAME).unlink()
    for offset in range(SAMPLES_OFFSET):
        with flipped(damaged / "tap-0002.wav", offset):
            refused("tap-0002.wav")
    for subtype in ("PCM_16", "FLOAT"):
        soundfile.write(damaged / "tap-0002.wav", np.zeros((100, 1)), 44_100, subtype)
        refused("tap-0002.wav")
    os.truncate(damaged / "tap-0001.wav", SAMPLES_OFFSET - 1)  # only the last may be torn
    refused("tap-0001.wav")


def test_without_index_and_segments_there_is_no_capture(damaged):
    for path in damaged.iterdir():
        path.unlink()
    with pytest.raises(UsageError, match="is not a capture"):
        Capture(damaged)
