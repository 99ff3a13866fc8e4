import contextlib
import errno
import os
import shutil
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.capture import Capture, CaptureWriter, format
from device.errors import UsageError, WriteError
from device.values import counted
from tests.support.taps import noise

STREAMS = ("tap", "effect")

# stream, frames, samplerate, channels
SMALL = [
    *(("tap", 3, 48_000, 2), ("effect", 3, 48_000, 1), ("tap", 0, 48_000, 2)),
    *(("tap", 2, 48_000, 2), ("effect", 2, 48_000, 1), ("tap", 4, 44_100, 1)),
    *(("tap", 0, 44_100, 1), ("tap", 1, 44_100, 1), ("effect", 5, 48_000, 1)),
]


def deliver(writer, number):
    stream, frames, samplerate, channels = SMALL[number]
    writer.write_buffer(stream, noise(frames, channels, number), samplerate, float(number))


def expected(numbers, stream):
    """What a reader must give for these of SMALL."""
    return [
        (number, samplerate, noise(frames, channels, number).tobytes())
        for number in numbers
        for own, frames, samplerate, channels in [SMALL[number]]
        if own == stream
    ]


EVERYTHING = range(len(SMALL))


def read(folder, stream):
    """The buffers as `expected` gives them, the times of discontinuities, and warnings."""
    capture = Capture(folder)
    buffers = list(capture.buffers(stream)) if stream in capture.streams else []
    found = [(buffer.time_s, buffer.samplerate, buffer.frames.tobytes()) for buffer in buffers]
    return found, [buffer.time_s for buffer in buffers if buffer.discontinuity], capture.warnings


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A capture of SMALL as kill -9 would leave it: never closed."""
    folder = tmp_path_factory.mktemp("small")
    writer = CaptureWriter(folder, streams=STREAMS)
    for number in range(len(SMALL)):
        deliver(writer, number)
    killed = Path(shutil.copytree(folder, tmp_path_factory.mktemp("killed") / "c"))
    writer.close()
    return killed


@pytest.fixture
def damaged(small, tmp_path):
    return Path(shutil.copytree(small, tmp_path / "damaged"))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(format.INDEX_NAME, marks=pytest.mark.exhaustive),
        *("tap-0001.wav", "tap-0002.wav", "effect-0001.wav"),
    ],
)
def test_a_file_cut_anywhere_gives_the_buffers_that_are_whole(damaged, name):
    if name == format.INDEX_NAME:
        after = np.cumsum([len(line) + 1 for line in (damaged / name).read_bytes().splitlines()])
        shortest, *whole_from = (after - 1).tolist()  # a line is whole without its line break
        ends = dict(enumerate(whole_from))
    else:
        stream_and_rate = (name[:-9], 44_100 if name[-5] == "2" else 48_000)
        mine = [n for n in EVERYTHING if (SMALL[n][0], SMALL[n][2]) == stream_and_rate]
        after = format.SAMPLES_OFFSET + np.cumsum([4 * SMALL[n][1] * SMALL[n][3] for n in mine])
        shortest, ends = 0, dict(zip(mine, after, strict=True))
    for size in range((damaged / name).stat().st_size, shortest - 1, -1):
        os.truncate(damaged / name, size)
        stream = STREAMS[size % 2] if name == format.INDEX_NAME else name[:-9]
        whole = [n for n in EVERYTHING if ends.get(n, 0) <= size]
        found, marked, warnings = read(damaged, stream)
        assert found == expected(whole, stream)
        mine = [n for n in EVERYTHING if SMALL[n][0] == stream]
        frames = sum(SMALL[n][1] for n in mine if n in whole)
        recovered = f"{counted(len(found), 'whole buffers')} ({frames} frames) of stream {stream}"
        assert recovered in warnings[-1]
        # Only the first buffer after a gap is a discontinuity.
        before = dict(zip(mine[1:], mine, strict=False))
        assert marked == [n for n in mine if n in whole and before.get(n, n) not in [*whole, n]]


@given(st.data())
@settings(max_examples=60)
def test_index_and_segments_cut_together_give_a_sound_beginning(small, tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("cut") / "c"
    shutil.copytree(small, folder)
    first_line = len((folder / format.INDEX_NAME).read_bytes().splitlines()[0])
    for path in sorted(folder.iterdir()):
        least = first_line if path.name == format.INDEX_NAME else 0
        os.truncate(path, data.draw(st.integers(least, path.stat().st_size)))
    for stream in STREAMS:
        found, _, warnings = read(folder, stream)
        kept = [int(time_s) for time_s, *_ in found]
        assert (found, kept) == (expected(kept, stream), sorted(set(kept)))
        assert any("was cut off" in text for text in warnings)


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
    Yield folder, acknowledged buffers, and what was raised."""
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


def assert_sound(folder, numbers=EVERYTHING):
    for stream in STREAMS:
        found, _, warnings = read(folder, stream)
        assert (found, warnings) == (expected(numbers, stream), [])


SHARES = pytest.mark.parametrize("share", [0.0, 0.5, 1.0])


@SHARES
def test_killed_at_any_moment_at_most_the_buffer_in_writing_is_lost(tmp_path, monkeypatch, share):
    for folder, acknowledged, _ in after_every_write(tmp_path, monkeypatch, Killed(), share):
        if not folder.is_dir() or folder.name == "0":
            continue  # killed while beginning
        for stream in STREAMS:
            found, marked, warnings = read(folder, stream)
            with_last = range(min(len(acknowledged) + 1, len(SMALL)))
            assert found in (expected(acknowledged, stream), expected(with_last, stream))
            assert not marked
            assert not warnings or ["was cut off" in text for text in warnings] == [True]
            assert warnings or len(acknowledged) == len(SMALL)


@SHARES
def test_a_write_that_fails_anywhere_leaves_what_was_acknowledged(tmp_path, monkeypatch, share):
    full = OSError(errno.ENOSPC, "No space left on device")
    for folder, acknowledged, raised in after_every_write(tmp_path, monkeypatch, full, share):
        assert "the disk is full" in str(raised)
        if folder.name == "0":
            assert not folder.exists()
            continue
        for stream in STREAMS:
            found, _, warnings = read(folder, stream)
            assert found == expected(acknowledged, stream)
            assert ["was cut off" in text for text in warnings] == [True]
        for path in folder.glob("*.wav"):
            assert (path.stat().st_size - format.SAMPLES_OFFSET) % 4 == 0


@SHARES
def test_an_interruption_anywhere_takes_that_buffer_and_no_other(tmp_path, monkeypatch, share):
    stop = KeyboardInterrupt()
    runs = after_every_write(tmp_path, monkeypatch, stop, share, ignored=[KeyboardInterrupt])
    for folder, kept, raised in runs:
        if raised:  # in the first line or in the last
            continue
        assert len(kept) == len(SMALL) - 1
        assert_sound(folder, kept)


BROKEN = Mock(side_effect=OSError(errno.EIO, "Input/output error"))


def test_after_a_failure_the_writer_is_done(tmp_path, monkeypatch):
    writer = CaptureWriter(tmp_path, streams=STREAMS)
    deliver(writer, 0)
    monkeypatch.setattr(os, "pwrite", BROKEN)
    with pytest.raises(WriteError, match="name another folder; it can be replayed up to there"):
        deliver(writer, 1)
    monkeypatch.undo()
    for write in (lambda: deliver(writer, 2), lambda: writer.note_dropped("tap", 1, 1)):
        with pytest.raises(WriteError, match="replayed up to there"):
            write()
    writer.close()
    assert read(tmp_path, "tap")[0] == expected([0], "tap")
    assert not list(Path("/proc/self/fd").glob(f"*{tmp_path.name}*"))


def test_a_disk_that_fails_at_the_end_is_told(tmp_path, monkeypatch):
    writer = CaptureWriter(tmp_path, streams=STREAMS)
    deliver(writer, 0)
    monkeypatch.setattr(os, "fsync", BROKEN)
    with pytest.raises(WriteError, match="cannot write to the capture"):
        writer.close()
    found, _, warnings = read(tmp_path, "tap")
    assert found == expected([0], "tap")
    assert "was cut off" in warnings[0]


def test_short_writes_are_continued(tmp_path, monkeypatch):
    pwrite = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda fd, content, at: pwrite(fd, bytes(content)[:3], at))
    record(tmp_path / "c", [])
    assert_sound(tmp_path / "c")


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
    index = damaged / format.INDEX_NAME
    for offset in range(index.stat().st_size):
        with flipped(index, offset):
            stream = STREAMS[offset // 8 % 2]
            found, marked, warnings = read(damaged, stream)
        everything = expected(EVERYTHING, stream)
        kept = [everything.index(buffer) for buffer in found]
        assert len(kept) >= len(everything) - 2
        before = [-1, *kept]
        gaps = [number for number, last in zip(kept, before, strict=False) if number > last + 1]
        assert marked == [everything[number][0] for number in gaps]
        assert any("damaged and left out" in text for text in warnings) == bool(gaps)


def test_lines_that_vanish_or_are_overwritten_are_a_gap_with_a_warning(damaged):
    index = damaged / format.INDEX_NAME
    lines = index.read_bytes().splitlines(keepends=True)
    for replacement in [b"", b"\0" * 400, b"\n\n", b"x" * 500_000 + b"\n", b'{"kind":1}\n']:
        index.write_bytes(b"".join([*lines[:3], replacement, *lines[5:]]))
        found, marked, warnings = read(damaged, "tap")
        kept = [0, 1, 4, 5, 6, 7, 8]
        if replacement.startswith(b"\0"):  # has no line break: takes the next line along
            kept.remove(4)
        assert (found, marked) == (expected(kept, "tap"), [5])
        assert "damaged and left out: 2 buffers of stream tap" in warnings[0]
        assert "first before buffer 3" in warnings[0]


WHOLE = format.BufferRecord("tap", 0, 1, 0, 3, 48_000, 2, 0.0, False, "00000000")
END, DROPPED, HEADER = (
    format.EndRecord({"tap": 1}),
    format.DroppedRecord("tap", 1, 0),
    format.Header(streams=["tap"]),
)


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
def test_a_line_that_no_recorder_writes_is_damaged(record: Any, name: str, value: object) -> None:
    assert format.parse_line(record.line()) == record
    assert format.parse_line(replace(record, **{name: value}).line()) is None


def test_a_damaged_first_line_costs_no_buffer(damaged):
    index = damaged / format.INDEX_NAME
    index.write_bytes(b"?" + index.read_bytes()[1:])
    for stream in STREAMS:
        found, _, warnings = read(damaged, stream)
        assert found == expected(EVERYTHING, stream)
        assert "first line is damaged; version 1 is assumed" in warnings[0]


def test_changed_samples_are_not_given_as_those_recorded(damaged):
    path = damaged / "tap-0001.wav"
    for offset in range(path.stat().st_size):
        with flipped(path, offset):
            found, marked, warnings = read(damaged, "tap")
        changed = None
        if offset >= format.SAMPLES_OFFSET:
            changed = 0 if offset < format.SAMPLES_OFFSET + 24 else 3
        assert found == expected([number for number in EVERYTHING if number != changed], "tap")
        assert marked == {None: [], 0: [2.0], 3: [5.0]}[changed]
        assert len(warnings) == (1 if changed is None else 2)


def test_a_missing_last_segment_of_a_closed_capture_is_told(tmp_path):
    record(tmp_path / "c", [])
    (tmp_path / "c" / "tap-0002.wav").unlink()
    found, _, (warning,) = read(tmp_path / "c", "tap")
    assert found == expected([0, 2, 3], "tap")
    assert "damaged at the end: 3 buffers; recovered: 3 whole buffers (5 frames)" in warning
    assert read(tmp_path / "c", "effect")[2] == []


def test_a_folder_or_a_pipe_in_place_of_a_segment_is_refused(damaged):
    path = damaged / "tap-0001.wav"
    for make in (Path.mkdir, os.mkfifo):
        path.unlink() if path.is_file() else path.rmdir()
        make(path)
        with pytest.raises(UsageError, match=r"tap-0001.wav is not a file"):
            read(damaged, "tap")


def test_a_huge_index_without_line_breaks_takes_no_memory(tmp_path):
    (tmp_path / format.INDEX_NAME).write_bytes(b'{"kind"' * 2_000_000)
    tracemalloc.start()
    with pytest.raises(UsageError, match="not a capture"):
        Capture(tmp_path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000


@pytest.mark.parametrize("index", [None, b"", b'{"kind":"capture","for', b"\0" * 5_000])
def test_without_an_index_the_segments_are_read_in_order_with_a_warning(damaged, index):
    (damaged / format.INDEX_NAME).unlink()
    if index is not None:
        (damaged / format.INDEX_NAME).write_bytes(index)
    found, _, (warning,) = read(damaged, "tap")
    assert [facts for *facts, _ in found] == [[0.0, 48_000], [5 / 48_000, 44_100]]
    whole = b"".join(content for *_, content in expected(EVERYTHING, "tap"))
    assert b"".join(content for *_, content in found) == whole
    assert "buffers of 1024 frames from time 0 on" in warning
    assert "sizes, times and discontinuities are not those recorded" in warning


def test_without_an_index_long_segments_come_in_buffers_of_the_stated_size(tmp_path):
    with CaptureWriter(tmp_path) as writer:
        writer.write_buffer("tap", noise(2_500, 1), 1_000, 77.0)
    (tmp_path / format.INDEX_NAME).unlink()
    found = [(len(buffer.frames), buffer.time_s) for buffer in Capture(tmp_path).buffers()]
    assert found == [(1_024, 0.0), (1_024, 1.024), (452, 2.048)]


def test_without_an_index_a_torn_last_segment_ends_with_its_last_whole_buffer(damaged):
    (damaged / format.INDEX_NAME).unlink()
    with (damaged / "tap-0002.wav").open("ab") as file:
        file.write(bytes(11))  # a piece of a buffer: two frames and a bit
    (damaged / "tap-0003.wav").write_bytes(b"RIFF")  # and a segment that had hardly begun
    assert [buffer.frames.shape for buffer in Capture(damaged).buffers()] == [(5, 2), (5, 1)]


def test_without_an_index_a_missing_segment_is_refused_as_ambiguous(damaged):
    (damaged / format.INDEX_NAME).unlink()
    (damaged / "tap-0001.wav").unlink()
    with pytest.raises(UsageError, match=r"lost index.jsonl and tap-0001.wav: .* one by one"):
        read(damaged, "tap")
    assert len(read(damaged, "effect")[0]) == 1  # that one is whole


def test_without_an_index_a_segment_of_no_capture_is_refused_and_not_guessed(damaged):
    def refused(name):
        with pytest.raises(UsageError, match=rf"{name} is not as a capture writes it"):
            read(damaged, "tap")

    (damaged / format.INDEX_NAME).unlink()
    for offset in range(format.SAMPLES_OFFSET):
        with flipped(damaged / "tap-0002.wav", offset):
            refused("tap-0002.wav")
    for subtype in ("PCM_16", "FLOAT"):
        soundfile.write(damaged / "tap-0002.wav", np.zeros((100, 1)), 44_100, subtype)
        refused("tap-0002.wav")
    os.truncate(damaged / "tap-0001.wav", format.SAMPLES_OFFSET - 1)  # only the last may be torn
    refused("tap-0001.wav")
