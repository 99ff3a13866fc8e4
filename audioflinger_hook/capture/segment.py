"""Segments of a capture: float32 WAV files, readable while they grow and after a crash."""

import os
import stat
import struct
import zlib
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from audioflinger_hook.capture.format import SAMPLES_OFFSET
from device.errors import InternalError, UsageError
from device.units import Float32Array
from device.wav_output import wav_header

_SAMPLE = np.dtype("<f4")
_FORMAT_AT = 56  # byte offset of format tag, channels and sample rate in the header
_DS64_FRAMES_AT = 36
_FACT_FRAMES_AT = 82


@dataclass(frozen=True)
class SegmentFormat:
    """Format and length of a segment. samplerate: Hz.

    frames_there: frames by the file's size. frames: those in the header, at most `frames_there`.
    """

    samplerate: int
    channels: int
    frames: int
    frames_there: int


class _Descriptor:
    _fd = -1

    def close(self) -> None:
        """Close the file. Repeated calls do nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class SegmentWriter(_Descriptor):
    """A new segment at `path`; an older file with this name is replaced.

    `append` writes a buffer to the file immediately, `keep` counts its frames in the header, and
    `cut` removes frames. Only one thread may call the methods, which may raise OSError.
    """

    def __init__(self, path: Path, samplerate: int, channels: int) -> None:
        self.path = path
        self.samplerate = samplerate
        self.channels = channels
        self.frames = 0
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC | os.O_NOFOLLOW
        self._fd = os.open(path, flags, 0o666)
        try:
            self.keep(0)
        except BaseException:
            self.discard()
            raise

    def append(self, frames: Float32Array) -> str:
        """Write frames at the end; return the CRC-32 of their samples as 8 hexadecimal digits."""
        samples = np.ascontiguousarray(frames, _SAMPLE).reshape(-1).view(np.uint8).data
        write_at(self._fd, samples, self._size())
        return f"{zlib.crc32(samples):08x}"

    def keep(self, frames: int) -> None:
        """Add `frames`, which `append` has written, to `self.frames`; write a new header."""
        self.frames += frames
        write_at(self._fd, wav_header(self.samplerate, self.channels, self.frames), 0)

    def cut(self, frames: int) -> None:
        """Truncate the segment to `frames` frames."""
        self.frames = frames
        with suppress(OSError):  # readers ignore bytes after the counted frames
            os.ftruncate(self._fd, self._size())
            self.keep(0)

    def discard(self) -> None:
        """Close the file and delete it."""
        self.close()
        with suppress(OSError):
            self.path.unlink()

    def _size(self) -> int:
        return SAMPLES_OFFSET + self.frames * self.channels * _SAMPLE.itemsize


class SegmentReader(_Descriptor):
    """Reads any buffer of a segment, even while the file grows. Only one thread may use it.

    FileNotFoundError: the file is missing. UsageError: it cannot be read or is not a regular file.
    """

    def __init__(self, path: Path) -> None:
        try:
            # Without O_NONBLOCK, opening a pipe would block until a writer opens the pipe.
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

    def read(self, first: int, frames: int, channels: int, crc: str = "") -> Float32Array | None:
        """Return samples (frames, channels) from frame `first` on; None if damaged or cut off."""
        start = SAMPLES_OFFSET + first * channels * _SAMPLE.itemsize
        # Check the size first, so that a damaged count allocates no memory.
        if start + frames * channels * _SAMPLE.itemsize > os.fstat(self._fd).st_size:
            return None
        samples = np.empty((frames, channels), _SAMPLE)
        content = samples.reshape(-1).view(np.uint8).data
        if not _read_at(self._fd, content, start) or (crc and f"{zlib.crc32(content):08x}" != crc):
            return None
        return samples.astype(np.float32, copy=False)

    def format(self) -> SegmentFormat | None:
        """Return format and length; None if the header is not that of a segment."""
        header = bytearray(SAMPLES_OFFSET)
        if not _read_at(self._fd, memoryview(header), 0):
            return None
        _tag, channels, samplerate = struct.unpack_from("<HHI", header, _FORMAT_AT)
        long = header.startswith(b"RF64")
        at = ("<Q", header, _DS64_FRAMES_AT) if long else ("<I", header, _FACT_FRAMES_AT)
        frames: int = struct.unpack_from(*at)[0]
        try:
            if wav_header(samplerate, channels, frames) != header:
                return None
        except (InternalError, struct.error):
            return None
        there = (os.fstat(self._fd).st_size - SAMPLES_OFFSET) // (channels * _SAMPLE.itemsize)
        return SegmentFormat(samplerate, channels, min(frames, there), there)


def segment_format(path: Path) -> SegmentFormat | None:
    """Return the format of a segment. The errors are those of `SegmentReader`."""
    with closing(SegmentReader(path)) as reader:
        return reader.format()


def write_at(fd: int, content: bytes | memoryview, position: int) -> None:
    """Write all bytes at a byte position of the file, or raise OSError."""
    rest = memoryview(content)
    while rest:
        written = os.pwrite(fd, rest, position)
        rest, position = rest[written:], position + written


def _read_at(fd: int, target: memoryview, position: int) -> bool:
    """Read bytes from a position until `target` is full; return False if the file is too short."""
    while target:
        got = os.preadv(fd, [target], position)
        if got == 0:
            return False
        target, position = target[got:], position + got
    return True


# eq=False, because == of two arrays returns an array, and a generated __eq__ would fail.
@dataclass(frozen=True, eq=False)
class CaptureBuffer:
    """A buffer exactly as it was delivered.

    frames: (frames, channels) float32, a copy. samplerate: Hz. time_s: time of delivery in s, by
    a monotonic clock. discontinuity: whether frames are missing before this buffer.
    """

    frames: Float32Array
    samplerate: int
    time_s: float
    discontinuity: bool

    @property
    def channels(self) -> int:
        """Number of channels."""
        return int(self.frames.shape[1])

    @property
    def format(self) -> tuple[int, int]:
        """Sample rate in Hz and number of channels."""
        return self.samplerate, self.channels
