"""Reads the buffers of a capture, unchanged."""

import os
from collections.abc import Generator, Iterator
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from pathlib import Path

from audioflinger_hook.capture import format as form
from audioflinger_hook.capture.format import INDEX_NAME, VERSION, segment_name, segment_paths
from audioflinger_hook.capture.segment import CaptureBuffer, SegmentReader, segment_format
from device.errors import UsageError
from device.values import counted

REBUILT_FRAMES = 1_024  # length of a buffer if the recorded lengths are lost

Buffers = Generator[CaptureBuffer, None, None]  # in order; `close()` closes the files


class Capture:
    """Reads a capture, which may be finished, incomplete, damaged or still growing.

    Only one thread, not the audio thread, may call the methods.

    - If the recording was killed or the disk was full, all whole buffers are read.
    - Buffers with damaged samples or a damaged index line are omitted. Then, `discontinuity` of the
      next buffer is True.
    - Without a readable index, the segments are read in order, in buffers of up to 1024 frames.

    folder: path of the capture. streams: names of its streams. facts: settings of the recording.
    warnings: messages about losses and assumptions; complete after the last buffer.
    UsageError: the folder is missing, unreadable, not a capture, or of an unknown version.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)
        self.warnings: list[str] = []
        self.facts: form.Facts = {}
        self._index = self.folder / INDEX_NAME
        self._rebuilt = False
        found = _streams_there(self.folder)
        first = form.first_record(self._index) if self._index.is_file() else None
        if isinstance(first, form.Header):
            if first.format != form.FORMAT:
                raise UsageError(
                    f"{self.folder} contains the format {first.format!r}; allowed: {form.FORMAT!r}"
                )
            if first.version != VERSION:
                raise UsageError(
                    f"{self.folder} is a capture of version {first.version}; this program reads "
                    f"version {VERSION}: use a newer one"
                )
            self.streams, self.facts = tuple(first.streams), first.facts
        elif first is not None:
            self.streams = found
            self._warn(f"{self._index}: the first line is damaged; version {VERSION} is assumed")
        elif found:
            self._rebuilt = True
            self.streams = found
        elif self._index.is_file() and form.begins_like_an_index(self._index):
            self.streams = ()
            self._warn(f"{self.folder} was cut off before the first buffer")
        else:
            raise UsageError(
                f"{self.folder} is not a capture; a folder with {INDEX_NAME} and "
                f"{segment_name('tap', 1)}, as `cushion capture` makes it, was expected"
            )

    def buffers(self, stream: str = "tap") -> Buffers:
        """Yield a stream's buffers. UsageError: the stream is unknown or cannot be read."""
        if self.streams and stream not in self.streams:
            raise UsageError(
                f"{self.folder} has no stream {stream!r}, only {', '.join(self.streams)}"
            )
        return self._rebuild(stream) if self._rebuilt else self._read(stream)

    def frames_expected(self, stream: str = "tap") -> int:
        """Return a stream's number of frames, computed from the sizes of its files."""
        found = map(segment_format, segment_paths(self.folder, stream).values())
        return sum(segment.frames_there for segment in found if segment is not None)

    def _read(self, stream: str) -> Buffers:
        if not self.streams:  # cut off before the first buffer
            return
        tally, number = _Tally(), 0
        segment: SegmentReader | None = None  # reads the segment `number`, unless that is missing
        with ExitStack() as opened:
            for record in form.records(self._index):
                if record is None:
                    tally.unread_lines += 1
                    continue
                tally.damaged_lines += tally.unread_lines
                tally.unread_lines = 0
                if isinstance(record, form.EndRecord):
                    tally.promised = record.buffers.get(stream, 0)
                elif isinstance(record, form.DroppedRecord) and record.stream == stream:
                    tally.dropped_buffers += record.buffers
                    tally.dropped_frames += record.frames
                    tally.after_drop = True
                elif isinstance(record, form.BufferRecord) and record.stream == stream:
                    if record.segment != number:
                        opened.close()
                        number, segment = record.segment, None
                        with suppress(FileNotFoundError):
                            path = self.folder / segment_name(stream, number)
                            segment = opened.enter_context(closing(SegmentReader(path)))
                    place = (record.first, record.frames, record.channels, record.samples_crc)
                    samples = segment.read(*place) if segment else None
                    if samples is None or record.buffer < tally.next_buffer:
                        continue
                    discontinuity = tally.take(record) or record.discontinuity
                    yield CaptureBuffer(samples, record.samplerate, record.time_s, discontinuity)
        for text in tally.warnings(stream):
            self._warn(f"{self.folder}: {text}")

    def _rebuild(self, stream: str) -> Buffers:
        paths = segment_paths(self.folder, stream)
        segments = []
        for expected, (number, path) in enumerate(paths.items(), 1):
            if number != expected:
                raise UsageError(
                    f"{self.folder} has lost {INDEX_NAME} and {segment_name(stream, expected)}: "
                    f"what came before {path.name} is not known; replay the WAV files one by one "
                    "with file:PATH"
                )
            found = segment_format(path)
            if found is not None:
                segments.append((path, found))
            elif number < len(paths) or path.stat().st_size >= form.SAMPLES_OFFSET:
                raise UsageError(
                    f"{self.folder} has lost {INDEX_NAME}, and {path.name} is not as a capture "
                    "writes it; take the file away, or replay the WAV files one by one with "
                    "file:PATH"
                )
        self._warn(
            f"{self.folder}: {INDEX_NAME} is missing or unreadable; stream {stream} is given in "
            f"buffers of {REBUILT_FRAMES} frames from time 0 on: sizes, times and discontinuities "
            "are not those recorded"
        )
        time_s = 0.0
        for path, segment in segments:
            with closing(SegmentReader(path)) as reader:
                for first in range(0, segment.frames, REBUILT_FRAMES):
                    count = min(REBUILT_FRAMES, segment.frames - first)
                    samples = reader.read(first, count, segment.channels)
                    if samples is None:  # the file was truncated meanwhile
                        return
                    at_s = time_s + first / segment.samplerate
                    yield CaptureBuffer(samples, segment.samplerate, at_s, discontinuity=False)
            time_s += segment.frames / segment.samplerate

    def _warn(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings.append(text)


@dataclass
class _Tally:
    next_buffer: int = 0
    taken_frames: int = 0
    lost_buffers: int = 0
    first_gap: int = 0
    dropped_buffers: int = 0
    dropped_frames: int = 0
    damaged_lines: int = 0
    unread_lines: int = 0
    promised: int | None = None
    after_drop: bool = False

    def take(self, record: form.BufferRecord) -> bool:
        lost = record.buffer - self.next_buffer
        if lost:
            self.first_gap = self.first_gap or record.buffer
            self.lost_buffers += lost
        missing = lost > 0 or self.after_drop
        self.after_drop = False
        self.next_buffer = record.buffer + 1
        self.taken_frames += record.frames
        return missing

    def warnings(self, stream: str) -> Iterator[str]:
        taken_buffers = self.next_buffer - self.lost_buffers
        recovered = (
            f"recovered: {counted(taken_buffers, 'whole buffers')} "
            f"({self.taken_frames} frames) of stream {stream}"
        )
        if self.dropped_buffers:
            yield (
                f"dropped while recording: {counted(self.dropped_buffers, 'buffers')} "
                f"({self.dropped_frames} frames) of stream {stream}; a discontinuity marks each"
            )
        if self.lost_buffers:
            yield (
                f"damaged and left out: {counted(self.lost_buffers, 'buffers')} of stream "
                f"{stream}, the first before buffer {self.first_gap}; a discontinuity marks each"
            )
        elif self.damaged_lines:
            yield (
                f"damaged: {counted(self.damaged_lines, 'lines')} of {INDEX_NAME}; no buffer of "
                f"stream {stream} is missing between others"
            )
        if self.promised is None:
            yield f"it was cut off (killed, disk full, or still being written); {recovered}"
        elif self.promised > self.next_buffer:
            lost = self.promised - self.next_buffer
            yield f"damaged at the end: {counted(lost, 'buffers')}; {recovered}"


def _streams_there(folder: Path) -> tuple[str, ...]:
    try:
        if not folder.exists():
            raise UsageError(f"{folder} does not exist; give the folder of a capture")
        if not folder.is_dir():
            raise UsageError(f"{folder} is not a folder; give the folder of a capture")
        return tuple(stream for stream in form.STREAMS if segment_paths(folder, stream))
    except OSError as error:
        raise UsageError(f"{folder} cannot be read ({error.strerror}); check permissions") from None
