import itertools
import json
import os
import tracemalloc
import zlib
from dataclasses import dataclass
from unittest.mock import Mock

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.capture import STREAMS, Capture, CaptureWriter
from audioflinger_hook.capture.format import INDEX_NAME, LINE_BYTES_MAX, Header
from audioflinger_hook.capture.segment import SegmentReader, SegmentWriter
from device.errors import InternalError, UsageError, WriteError


@dataclass(frozen=True)
class Delivery:
    """A buffer as the test hands it over; any bits may be samples."""

    stream: str = "tap"
    frames: int = 3
    samplerate: int = 48_000
    channels: int = 2
    time_s: float = 1.0
    discontinuity: bool = False
    seed: int = 0

    @property
    def samples(self):
        random = np.random.default_rng(self.seed)
        bits = random.integers(0, 2**32, (self.frames, self.channels), dtype=np.uint32)
        bits.reshape(-1)[::7] |= 0x7F80_0000  # every seventh is NaN with a payload, or infinite
        return bits.view(np.float32)

    @property
    def key(self):
        return key(self, self.samples)


def key(facts, samples):
    format_and_time = (facts.samplerate, facts.channels, facts.time_s, facts.discontinuity)
    return (samples.tobytes(), samples.shape, *format_and_time)


def written(folder, *deliveries, **options):
    with CaptureWriter(folder, **options) as writer:
        for delivery in deliveries:
            deliver(writer, delivery)
    return folder


def deliver(writer, one):
    facts = (one.stream, one.samples, one.samplerate, one.time_s)
    writer.write_buffer(*facts, discontinuity=one.discontinuity)


def contents(folder, stream="tap"):
    capture = Capture(folder)
    return [key(buffer, buffer.frames) for buffer in capture.buffers(stream)], capture.warnings


sizes = st.one_of(st.sampled_from([0, 1, 255, 256, 257, 20_000]), st.integers(0, 300))
deliveries = st.builds(
    Delivery,
    stream=st.sampled_from(STREAMS),
    frames=sizes,
    samplerate=st.sampled_from([1, 44_100, 48_000, 192_000]),
    channels=st.sampled_from([1, 2, 32]),
    time_s=st.floats(allow_nan=False, allow_infinity=False),
    discontinuity=st.booleans(),
    seed=st.integers(0, 2**32),
)


@settings(max_examples=40)
@given(st.lists(deliveries, max_size=12))
def test_every_buffer_of_every_stream_comes_back_bit_for_bit(tmp_path_factory, given_buffers):
    folder = tmp_path_factory.mktemp("capture")
    with CaptureWriter(folder, streams=STREAMS) as writer:
        for delivery in given_buffers:
            deliver(writer, delivery)
    for stream in STREAMS:
        mine = [delivery for delivery in given_buffers if delivery.stream == stream]
        assert contents(folder, stream) == ([delivery.key for delivery in mine], [])
        assert writer.buffers(stream) == len(mine)
        frames = sum(delivery.frames for delivery in mine)
        assert frames == writer.frames(stream) == Capture(folder).frames_expected(stream)


def test_a_change_of_format_and_nothing_else_starts_a_segment(tmp_path):
    formats = [(48_000, 2), (48_000, 2), (44_100, 2), (44_100, 1), (48_000, 2)]
    tap = [Delivery("tap", 5, *one, discontinuity=True) for one in formats]
    written(tmp_path, *tap, *[Delivery("effect", 5, 48_000, 1)] * 5, streams=("tap", "effect"))
    segments = {path.name: soundfile.info(path) for path in tmp_path.glob("*.wav")}
    found = {name: (i.samplerate, i.channels, i.frames) for name, i in segments.items()}
    assert found == {
        "tap-0001.wav": (48_000, 2, 10),
        "tap-0002.wav": (44_100, 2, 5),
        "tap-0003.wav": (44_100, 1, 5),
        "tap-0004.wav": (48_000, 2, 5),
        "effect-0001.wav": (48_000, 1, 25),
    }
    assert {i.subtype for i in segments.values()} == {"FLOAT"}


def test_two_readers_at_a_time_do_not_disturb_one_another_and_own_what_they_get(tmp_path):
    given_buffers = [Delivery(seed=seed, samplerate=1_000 * (seed // 2 + 1)) for seed in range(6)]
    capture, found = Capture(written(tmp_path, *given_buffers)), []
    for one, other in zip(capture.buffers(), capture.buffers(), strict=True):
        one.frames[:] = 0.0
        found.append(key(other, other.frames))
    assert found == contents(tmp_path)[0] == [delivery.key for delivery in given_buffers]


def test_frames_in_any_memory_layout_are_kept(tmp_path):
    frames = Delivery(frames=40, channels=4).samples
    layouts = [np.asfortranarray(frames), frames[::3, 1:3], frames[::-1], frames[:, :0:-1]]
    with CaptureWriter(tmp_path) as writer:
        for layout in layouts:
            writer.write_buffer("tap", layout, 48_000, 0.0)
    found = [buffer.frames.tobytes() for buffer in Capture(tmp_path).buffers()]
    assert found == [np.ascontiguousarray(layout).tobytes() for layout in layouts]


def test_the_index_is_what_the_format_says(tmp_path):
    with CaptureWriter(tmp_path, facts={"tap": "sink:Grüße", "latency_s": 0.05}) as writer:
        deliver(writer, Delivery(time_s=0.1, discontinuity=True))
        writer.note_dropped("tap", 2, 512)
    lines = (tmp_path / INDEX_NAME).read_bytes().splitlines()
    fields = [json.loads(line) for line in lines]
    for line, found in zip(lines, fields, strict=True):
        assert int(found.pop("crc"), 16) == zlib.crc32(line[: line.rindex(b',"crc"')])
    assert fields[0]["facts"].pop("program").startswith("haptic-cushion ")
    samples_crc = f"{zlib.crc32(Delivery().samples.tobytes()):08x}"
    assert fields == [
        {"kind": "capture", "format": "haptic-cushion capture", "version": 1}
        | {"streams": ["tap"], "facts": {"tap": "sink:Grüße", "latency_s": 0.05}},
        {"kind": "buffer", "stream": "tap", "buffer": 0, "segment": 1, "first": 0, "frames": 3}
        | {"samplerate": 48_000, "channels": 2, "time_s": 0.1, "discontinuity": True}
        | {"samples_crc": samples_crc},
        {"kind": "dropped", "stream": "tap", "buffers": 2, "frames": 512},
        {"kind": "end", "buffers": {"tap": 1}},
    ]
    assert Capture(tmp_path).facts["tap"] == "sink:Grüße"


def test_a_reader_may_follow_a_writer_and_a_player_reads_what_was_never_closed(tmp_path):
    writer, segment = CaptureWriter(tmp_path), tmp_path / "tap-0001.wav"
    for seed in range(5):
        assert len(contents(tmp_path)[0]) == seed
        deliver(writer, Delivery(frames=480, seed=seed))
    assert "still being written" in contents(tmp_path)[1][0]
    assert soundfile.info(segment).frames == 2_400
    with segment.open("ab") as file:
        file.write(bytes(range(1, 100)))  # a piece of the next buffer
    assert soundfile.read(segment)[0].shape == (2_400, 2)
    writer.close()
    assert contents(tmp_path)[1] == []


def test_a_segment_over_4_gb_can_be_read_anywhere(tmp_path):
    segment = SegmentWriter(tmp_path / "tap-0001.wav", 48_000, 1)
    samples = Delivery(frames=5, channels=1).samples
    segment.frames = 2**30  # a hole: takes no room on the disk
    crc = segment.append(samples)
    segment.keep(5)
    segment.close()
    info = soundfile.info(tmp_path / "tap-0001.wav")
    assert (info.format, info.frames) == ("RF64", 2**30 + 5)
    reader = SegmentReader(tmp_path / "tap-0001.wav")
    found, found_format = reader.read(2**30, 5, 1, crc), reader.format()
    assert found is not None
    assert found_format is not None
    assert (found.tobytes(), found_format.frames) == (samples.tobytes(), 2**30 + 5)
    reader.close()


def test_memory_stays_flat_whatever_the_length(tmp_path):
    frames = Delivery(frames=2_000).samples

    def write(count):
        for _ in range(count):
            writer.write_buffer("tap", frames, 48_000, 0.0)

    def read(count):
        some = itertools.islice(Capture(tmp_path).buffers(), count)
        assert sum(len(buffer.frames) for buffer in some) == count * 2_000

    with CaptureWriter(tmp_path) as writer:
        for work in (write, read):
            work(20)
            tracemalloc.start()
            work(400)
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            assert peak < 20 * frames.nbytes  # of 400 times that


def test_a_folder_that_cannot_be_used_is_the_users_mistake_and_stays_as_it_is(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    for folder, words in (
        (tmp_path, "not empty; name a new one"),
        (tmp_path / "a\0b", "null"),
        (tmp_path / ("x" * 300), "too long"),
    ):
        with pytest.raises(UsageError, match=words):
            CaptureWriter(folder)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(
    ("wrong", "kind", "text"),
    [
        (PermissionError(13, "Permission denied"), UsageError, "no permission to write there"),
        (OSError(30, "Read-only file system"), UsageError, "read-only"),
        (FileExistsError(17, "File exists"), UsageError, "another capture began there"),
        (OSError(28, "No space left on device"), WriteError, "disk is full"),
        *(
            ({"streams": one}, InternalError, "streams=")
            for one in [(), ("tap", "tap"), ("sound",), ("../tap",)]
        ),
        *(
            ({"facts": {"x": one}}, InternalError, "capture line")
            for one in ["y" * LINE_BYTES_MAX, np.nan, open]
        ),
    ],
)
def test_a_capture_that_cannot_begin_leaves_no_folder(tmp_path, monkeypatch, wrong, kind, text):
    options = wrong if isinstance(wrong, dict) else {}
    if not options:
        monkeypatch.setattr(os, "open", Mock(side_effect=wrong))
    with pytest.raises(kind, match=text):
        CaptureWriter(tmp_path / "c", **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("frames", "samplerate", "time_s", "stream", "text"),
    [
        (np.zeros(4, np.float32), 48_000, 0.0, "tap", r"shape \(4,\)"),
        (np.zeros((4, 2)), 48_000, 0.0, "tap", "float64"),
        (np.zeros((4, 0), np.float32), 48_000, 0.0, "tap", "channels=0"),
        (np.zeros((4, 2), np.float32), 0, 0.0, "tap", "samplerate=0"),
        (np.zeros((4, 2), np.float32), 48_000, np.nan, "tap", "time_s=nan"),
        (np.zeros((4, 2), np.float32), 48_000, 0.0, "device", "no stream 'device'"),
    ],
)
def test_what_is_no_buffer_leaves_no_trace(tmp_path, frames, samplerate, time_s, stream, text):
    with CaptureWriter(tmp_path) as writer:
        deliver(writer, Delivery(seed=1))
        with pytest.raises(InternalError, match=text):
            writer.write_buffer(stream, frames, samplerate, time_s)
        deliver(writer, Delivery(seed=2))
    assert contents(tmp_path) == ([Delivery(seed=1).key, Delivery(seed=2).key], [])
    assert sorted(path.name for path in tmp_path.iterdir()) == [INDEX_NAME, "tap-0001.wav"]


def test_nothing_is_written_after_the_end(tmp_path):
    writer = CaptureWriter(tmp_path)
    for _ in range(2):
        writer.close()
    for write in (lambda: deliver(writer, Delivery()), lambda: writer.note_dropped("tap", 1, 1)):
        with pytest.raises(InternalError, match="closed"):
            write()
    assert contents(tmp_path) == ([], [])


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"version": 2}, "version 2; this program reads version 1: use a newer one"),
        ({"format": "other"}, "contains the format 'other'"),
    ],
)
def test_an_unknown_version_is_refused(tmp_path, fields, text):
    index = written(tmp_path, Delivery()) / INDEX_NAME
    rest = index.read_bytes().partition(b"\n")[2]
    index.write_bytes(Header(streams=["tap"], **fields).line() + rest)
    with pytest.raises(UsageError, match=text):
        Capture(tmp_path)


def test_foreign_files_in_the_folder_are_left_alone(tmp_path):
    with CaptureWriter(tmp_path) as writer:
        deliver(writer, Delivery())
        foreign = ["notes.txt", "tap-0001.wav.bak", "tap-2.wav", "tap-00002.wav", "xtap-0001.wav"]
        for name in foreign:
            (tmp_path / name).write_text("mine")
        (tmp_path / "tap-0009.wav.d").mkdir()
    assert contents(tmp_path) == ([Delivery().key], [])
    assert Capture(tmp_path).streams == ("tap",)
    assert {(tmp_path / name).read_text() for name in foreign} == {"mine"}
