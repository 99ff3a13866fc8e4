import errno
import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from unittest.mock import Mock

import numpy as np
import pytest

from audioflinger_hook.capture import Capture, CaptureRecorder, CaptureWriter
from device.errors import InternalError, WriteError


class HeldWriter(CaptureWriter):
    """A writer on a disk that hangs until `go` is set."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.go = threading.Event()

    def write_buffer(self, *args, **options):
        assert self.go.wait(20)
        super().write_buffer(*args, **options)


def frames_of(number, frames=4, channels=2):
    return np.full((frames, channels), number, np.float32)


def read(folder):
    capture = Capture(folder)
    return [(one.time_s, one.discontinuity) for one in capture.buffers()], capture.warnings


def offer_until_taken(recorder, frames, time_s, **options):
    while not recorder.offer("tap", frames, 48_000, time_s, **options):
        threading.Event().wait(0.001)  # a full ring: not so patient on an audio thread


def test_what_is_handed_over_arrives_bit_for_bit_through_many_turns_of_the_ring(tmp_path):
    random = np.random.default_rng(5)
    recorder = CaptureRecorder(CaptureWriter(tmp_path), capacity_samples=4_096)
    handed, scratch = [], np.empty((512, 4), np.float32)
    for number in range(1_000):
        shape = int(random.integers(0, 300)), 1 + number // 100 % 4
        frames = scratch[: shape[0], : shape[1]]  # the caller uses its memory again
        bits = random.integers(0, 2**32, shape, dtype=np.uint32)
        frames[...] = bits.view(np.float32)
        handed.append((frames.tobytes(), shape, float(number)))
        offer_until_taken(recorder, frames, float(number), discontinuity=number % 11 == 0)
    recorder.close()
    assert recorder.error is None
    buffers = Capture(tmp_path).buffers()
    assert [(one.frames.tobytes(), one.frames.shape, one.time_s) for one in buffers] == handed


def test_nothing_waits_and_what_finds_no_room_is_dropped_counted_and_marked_in_its_stream(tmp_path):
    writer = HeldWriter(tmp_path, streams=("tap", "effect"))
    recorder = CaptureRecorder(writer, capacity_samples=5 * 8)
    taken = [recorder.offer("tap", frames_of(number), 48_000, float(number)) for number in range(9)]
    assert (taken, recorder.dropped("tap")) == ([True] * 5 + [False] * 4, (4, 16))
    writer.go.set()
    number = 9
    while not recorder.offer("tap", frames_of(number), 48_000, float(number)):
        number += 1
    assert recorder.offer("effect", frames_of(0), 48_000, 0.0)
    recorder.close()
    buffers, warnings = read(tmp_path)
    assert buffers == [(float(n), False) for n in range(5)] + [(float(number), True)]
    (warning,) = warnings
    buffers_dropped, frames_dropped = recorder.dropped("tap")
    assert (buffers_dropped, frames_dropped) == (number - 5, 4 * (number - 5))
    assert f"{buffers_dropped} buffers ({frames_dropped} frames) of stream tap" in warning
    assert [one.discontinuity for one in Capture(tmp_path).buffers("effect")] == [False]


def test_drops_at_the_very_end_are_in_the_capture_too(tmp_path):
    writer = HeldWriter(tmp_path)
    recorder = CaptureRecorder(writer, capacity_samples=8)
    taken = [recorder.offer("tap", frames_of(number), 48_000, float(number)) for number in range(2)]
    assert taken == [True, False]
    writer.go.set()
    for _ in range(2):
        recorder.close()
    assert not recorder.offer("tap", frames_of(2), 48_000, 2.0)  # too late
    assert recorder.dropped("tap") == (2, 8)
    buffers, warnings = read(tmp_path)
    assert buffers == [(0.0, False)]
    assert "dropped while recording: 1 buffer (4 frames) of stream tap" in warnings[0]


def test_empty_buffers_are_bounded_too(tmp_path):
    writer = HeldWriter(tmp_path)
    recorder = CaptureRecorder(writer, capacity_buffers=3)
    taken = [recorder.offer("tap", frames_of(0, 0), 48_000, 0.0) for _ in range(5)]
    assert taken == [True, True, True, False, False]
    writer.go.set()
    recorder.close()


def test_a_buffer_as_long_as_the_ring_finds_room_and_a_longer_one_never(tmp_path):
    recorder = CaptureRecorder(CaptureWriter(tmp_path), capacity_samples=80)
    for number in range(50):
        offer_until_taken(recorder, frames_of(number, 30 + number % 11), float(number))
    assert not recorder.offer("tap", frames_of(0, 41), 48_000, 0.0)
    recorder.close()
    assert len(read(tmp_path)[0]) == 50


def test_each_stream_may_have_a_thread_of_its_own(tmp_path):
    streams = ("tap", "effect", "device")
    recorder = CaptureRecorder(CaptureWriter(tmp_path, streams=streams))
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)

    def feed(stream):
        for number in range(1_000):
            assert recorder.offer(stream, frames_of(number, 7), 48_000, float(number))

    with ThreadPoolExecutor() as pool:
        assert len(list(pool.map(feed, streams))) == 3
    sys.setswitchinterval(interval)
    recorder.close()
    for stream in streams:
        buffers = list(Capture(tmp_path).buffers(stream))
        assert [buffer.time_s for buffer in buffers] == list(range(1_000))
        assert all(np.all(buffer.frames == buffer.time_s) for buffer in buffers)


DROPPED = "dropped while recording: 2 buffers (8 frames) of stream tap"


@pytest.mark.parametrize(
    ("failure", "kind", "words", "warning"),
    [
        (OSError(errno.ENOSPC, "No space"), WriteError, "the disk is full", "1 whole buffer "),
        (MemoryError("none left"), InternalError, "MemoryError: none left", DROPPED),
        (None, InternalError, "float64", DROPPED),  # a buffer of another type
    ],
)
def test_a_failure_ends_the_capture_and_is_raised_at_the_end_not_on_the_audio_thread(
    tmp_path, monkeypatch, failure, kind, words, warning
):
    writer = CaptureWriter(tmp_path)
    recorder = CaptureRecorder(writer)
    assert recorder.offer("tap", frames_of(0), 48_000, 0.0)
    while not writer.buffers("tap"):
        threading.Event().wait(0.001)

    if failure:
        monkeypatch.setattr(os, "pwrite", Mock(side_effect=failure))
    second = frames_of(1) if failure else frames_of(1).astype(float)
    assert recorder.offer("tap", second, 48_000, 1.0) == bool(failure)
    while recorder.error is None:
        threading.Event().wait(0.001)
    assert not recorder.offer("tap", frames_of(2), 48_000, 2.0)
    monkeypatch.undo()
    with pytest.raises(kind, match=words):
        recorder.close()
    recorder.close()
    assert recorder.dropped("tap") == (2, 8)
    buffers, warnings = read(tmp_path)
    assert buffers == [(0.0, False)]
    assert warning in warnings[0]
