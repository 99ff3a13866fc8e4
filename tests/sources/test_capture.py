"""A capture as a tap: buffers as delivered, with every change of format and discontinuity."""

import pytest

from audioflinger_hook.capture import CaptureWriter
from audioflinger_hook.sources import Tap
from audioflinger_hook.sources.file import CaptureTap
from device.errors import UsageError
from tests.support.taps import noise


def captured(folder, *buffers, stream="tap"):
    """Write buffers at 48 kHz as a capture, and return its folder."""
    with CaptureWriter(folder, streams=(stream,)) as writer:
        for frames in buffers:
            writer.write_buffer(stream, frames, 48_000, 0.0)
    return folder


def test_buffers_formats_times_and_discontinuities_are_those_delivered(tmp_path):
    delivered = [
        *((noise(480), 48_000, 10.0, False), (noise(0), 48_000, 10.25, False)),
        *((noise(7, seed=1), 48_000, 10.5, True), (noise(5, 1), 48_000, 10.75, False)),
        *((noise(5, 1, 2), 44_100, 11.0, False), (noise(9, 1, 3), 44_100, 11.5, False)),
    ]
    with CaptureWriter(tmp_path) as writer:
        for frames, samplerate, time_s, discontinuity in delivered:
            writer.write_buffer("tap", frames, samplerate, time_s, discontinuity=discontinuity)
    tap = CaptureTap(tmp_path)
    as_a_tap: Tap = tap
    assert (as_a_tap.samplerate, as_a_tap.channels) == (48_000, 2)
    assert as_a_tap.frames_expected == 480 + 7 + 5 + 5 + 9
    found, changes = [], []
    while (buffer := tap.read()) is not None:
        assert buffer.shape[1] == tap.channels
        found.append((buffer.tobytes(), tap.samplerate, tap.time_s, tap.discontinuity))
        changes.append(tap.format_changed)
    assert found == [(frames.tobytes(), *rest) for frames, *rest in delivered]
    assert changes == [False, False, False, True, True, False]
    assert tap.read() is None
    assert tap.warnings == []
    tap.close()
    tap.close()
    assert tap.read() is None


def test_a_capture_without_sound_is_refused(tmp_path):
    for name, buffers in (("a", []), ("b", [noise(0)]), ("c", [noise(0), noise(0, 1)])):
        with pytest.raises(UsageError, match=r"has no sound \(0 frames\)"):
            CaptureTap(captured(tmp_path / name, *buffers))
    (tmp_path / "d").mkdir()
    (tmp_path / "d/index.jsonl").write_bytes(b'{"kind":"capt')
    with pytest.raises(UsageError, match="cut off before the first buffer"):
        CaptureTap(tmp_path / "d")
    with pytest.raises(UsageError, match="no stream 'tap', only effect"):
        CaptureTap(captured(tmp_path / "e", noise(3), stream="effect"))


def test_a_format_that_the_transform_does_not_take_is_refused_where_it_comes(tmp_path):
    with CaptureWriter(tmp_path / "first") as writer:
        writer.write_buffer("tap", noise(3), 8, 0.0)
    with pytest.raises(UsageError, match=r"first: samplerate=8 Hz is out of range"):
        CaptureTap(tmp_path / "first")
    tap = CaptureTap(captured(tmp_path / "second", noise(3), noise(3, 65)))
    assert tap.read() is not None
    with pytest.raises(UsageError, match=r"second: channels=65 is out of range"):
        tap.read()
