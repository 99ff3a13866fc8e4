"""Segments of a capture: float32 WAV files that can be read while they grow and after a kill."""

from __future__ import annotations

import contextlib
import os
import stat
import struct
import zlib
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.capture.format import INDEX_NAME, SAMPLES_OFFSET, segment_name, segment_paths
from device.errors import InternalError, UsageError
from device.wav_output import wav_header

_SAMPLE = np.dtype("<f4")
_FORMAT_AT = 56  # behind RIFF, ds64 or JUNK, and the head of the fmt chunk: tag, channels, rate
_DS64_FRAMES_AT = 36
_FACT_FRAMES_AT = 82


@dataclass(frozen=True)
class SegmentFormat:
    """What a segment holds.

    samplerate: Hz; frames: whole frames by its header, which knows whole buffers only;
    frames_there: whole frames by its length.
    """

    samplerate: int
    channels: int
    frames: int
    frames_there: int


class SegmentWriter:
    """A new segment at `path`; an older file of that name is replaced.

    Samples go to the operating system at once. `append` puts them behind the last buffer, `keep`
    makes them part of the file as its header tells it, `cut` takes them away again. One thread;
    every method may raise OSError.
    """

    def __init__(self, path: Path, samplerate: int, channels: int) -> None:
        self.path = path
        self.samplerate = samplerate
        self.channels = channels
        self.frames = 0
        header = wav_header(samplerate, channels, 0)
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC | os.O_NOFOLLOW
        self._fd = os.open(path, flags, 0o666)
        try:
            write_at(self._fd, header, 0)
        except BaseException:
            self.discard()
            raise

    def append(self, frames: NDArray[np.float32]) -> int:
        """Write a buffer's samples behind those kept, and return their CRC-32."""
        samples = np.ascontiguousarray(frames, _SAMPLE).reshape(-1).view(np.uint8).data
        write_at(self._fd, samples, self._size())
        return zlib.crc32(samples)

    def keep(self, frames: int) -> None:
        """Count the frames appended last, in the header too."""
        self.frames += frames
        write_at(self._fd, wav_header(self.samplerate, self.channels, self.frames), 0)

    def cut(self, frames: int) -> None:
        """Go back to the first `frames` frames, as far as the disk lets us."""
        self.frames = frames
        with contextlib.suppress(OSError):  # what lies behind harms no reader
            os.ftruncate(self._fd, self._size())
            write_at(self._fd, wav_header(self.samplerate, self.channels, frames), 0)

    def close(self) -> None:
        """Let go of the file. May be called more than once."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def discard(self) -> None:
        """Close the file and remove it."""
        self.close()
        with contextlib.suppress(OSError):
            self.path.unlink()

    def _size(self) -> int:
        return SAMPLES_OFFSET + self.frames * self.channels * _SAMPLE.itemsize


class SegmentReader:
    """Samples of a segment, any buffer of it, also while it grows. One thread.

    FileNotFoundError: there is no such file.
    UsageError: it may not be read, or is no file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            # Opening a pipe would wait for somebody to write into it.
            self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        except FileNotFoundError:
            raise
        except OSError as error:
            raise UsageError(
                f"{path} may not be read ({error.strerror}); check its permissions"
            ) from None
        if not stat.S_ISREG(os.fstat(self._fd).st_mode):
            self.close()
            raise UsageError(f"{path} is not a file; a capture's segment was expected there")

    def read(
        self, first: int, frames: int, channels: int, crc: int | None = None
    ) -> NDArray[np.float32] | None:
        """Return (frames, channels) samples from frame `first` on, or None if they are not whole.

        crc: what their CRC-32 must be; None where it is not known.
        """
        start = SAMPLES_OFFSET + first * channels * _SAMPLE.itemsize
        # Asked first: a damaged count must not ask for memory.
        if start + frames * channels * _SAMPLE.itemsize > os.fstat(self._fd).st_size:
            return None
        samples = np.empty((frames, channels), _SAMPLE)
        content = samples.reshape(-1).view(np.uint8).data
        if not _read_at(self._fd, content, start):
            return None
        if crc is not None and zlib.crc32(content) != crc:
            return None
        return samples.astype(np.float32, copy=False)

    def format(self) -> SegmentFormat | None:
        """What the segment says it holds; None where its header is not a `SegmentWriter`'s."""
        header = bytearray(SAMPLES_OFFSET)
        if not _read_at(self._fd, memoryview(header), 0):
            return None
        _tag, channels, samplerate = struct.unpack_from("<HHI", header, _FORMAT_AT)
        frames: int
        if header.startswith(b"RF64"):
            (frames,) = struct.unpack_from("<Q", header, _DS64_FRAMES_AT)
        else:
            (frames,) = struct.unpack_from("<I", header, _FACT_FRAMES_AT)
        try:
            if wav_header(samplerate, channels, frames) != header:
                return None
        except (InternalError, struct.error):
            return None
        there = (os.fstat(self._fd).st_size - SAMPLES_OFFSET) // (channels * _SAMPLE.itemsize)
        return SegmentFormat(samplerate, channels, min(frames, there), there)

    def close(self) -> None:
        """Let go of the file. May be called more than once."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


def segment_format(path: Path) -> SegmentFormat | None:
    """`SegmentReader.format` of the file; raises what `SegmentReader` raises."""
    with contextlib.closing(SegmentReader(path)) as reader:
        return reader.format()


def write_at(fd: int, content: bytes | memoryview, position: int) -> None:
    """Write all of the bytes at that position, or raise OSError."""
    rest = memoryview(content)
    while rest:
        written = os.pwrite(fd, rest, position)
        rest, position = rest[written:], position + written


def _read_at(fd: int, target: memoryview, position: int) -> bool:
    """Fill the target from that position on; False where the file ends before."""
    while target:
        got = os.preadv(fd, [target], position)
        if got == 0:
            return False
        target, position = target[got:], position + got
    return True


# eq=False: comparing arrays with == gives arrays, so a generated __eq__ could only fail.
@dataclass(frozen=True, eq=False)
class CaptureBuffer:
    """A buffer exactly as it was delivered.

    Attributes
    ----------
    frames : array of float32
        (frames, channels), possibly empty; the reader owns it.
    samplerate : int
        Hz.
    time_s : float
        Time of its delivery, seconds of the recorder's monotonic clock.
    discontinuity : bool
        Whether frames are missing before it: at the source, in the recorder or in the capture.
    """

    frames: NDArray[np.float32]
    samplerate: int
    time_s: float
    discontinuity: bool

    @property
    def channels(self) -> int:
        """Number of channels."""
        return int(self.frames.shape[1])

    @property
    def format(self) -> tuple[int, int]:
        """Samplerate in Hz and number of channels."""
        return self.samplerate, self.channels


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
