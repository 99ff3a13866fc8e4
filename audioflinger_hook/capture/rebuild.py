"""Buffers of a capture that lost its index, made from its segments, numbered without a gap."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from audioflinger_hook.capture.buffer import CaptureBuffer
from audioflinger_hook.capture.format import INDEX_NAME, SAMPLES_OFFSET, segment_name, segment_paths
from audioflinger_hook.capture.segment import SegmentFormat, SegmentReader, segment_format
from device.errors import UsageError

REBUILT_FRAMES = 1_024
"""Frames of a buffer, where nobody knows how many there were."""


def rebuilt_buffers(folder: Path, stream: str) -> Iterator[CaptureBuffer]:
    """The stream in buffers of `REBUILT_FRAMES`; the last of each segment may be shorter.

    Raises UsageError where the order of the segments is ambiguous or one is not a capture's.
    """
    time_s = 0.0
    for path, segment in ordered_segments(folder, stream):
        with closing(SegmentReader(path)) as reader:
            for first in range(0, segment.frames, REBUILT_FRAMES):
                count = min(REBUILT_FRAMES, segment.frames - first)
                samples = reader.read(first, count, segment.channels)
                if samples is None:  # it has become shorter since
                    return
                at_s = time_s + first / segment.samplerate
                yield CaptureBuffer(samples, segment.samplerate, at_s, discontinuity=False)
        time_s += segment.frames / segment.samplerate


def ordered_segments(folder: Path, stream: str) -> list[tuple[Path, SegmentFormat]]:
    """The stream's segments in order, or UsageError where there is no telling."""
    paths = segment_paths(folder, stream)
    segments = []
    for expected, (number, path) in enumerate(paths.items(), 1):
        if number != expected:
            raise UsageError(
                f"{folder} has lost {INDEX_NAME} and {segment_name(stream, expected)}: what came "
                f"before {path.name} is not known; replay the WAV files one by one with file:PATH"
            )
        found = segment_format(path)
        if found is not None:
            segments.append((path, found))
        elif number < len(paths) or path.stat().st_size >= SAMPLES_OFFSET:
            raise UsageError(
                f"{folder} has lost {INDEX_NAME}, and {path.name} is not as a capture writes it; "
                "take the file away, or replay the WAV files one by one with file:PATH"
            )
    return segments
