"""Taps of stored sound: a file, frames in memory, a capture."""

import os
import re
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import soundfile

from audioflinger_hook.capture import Capture, CaptureBuffer
from audioflinger_hook.sources.tap import SteadyTap, named, reason_of
from audioflinger_hook.transform.parameters import check_format
from device.errors import UsageError
from device.units import Float32Array

BLOCKSIZE_FRAMES = 32_768  # frames per buffer; 64 channels take 8 MB
EXACT_FORMATS = frozenset({"WAV", "WAVEX", "RF64", "W64", "AIFF", "AU", "CAF"})
EXACT_SUBTYPES = frozenset({"PCM_U8", "PCM_S8", "PCM_16", "PCM_24", "PCM_32", "FLOAT", "DOUBLE"})
"""Formats in which reading can start at any frame without a change of the samples."""

FRAMES_UNKNOWN = 1 << 40  # libsndfile reports at least this length for an unknown length


class FileTap(SteadyTap):
    """A tap of a sound file in any format of libsndfile.

    path: path of the file. blocksize: frames per buffer. first: first frame to read; must be 0
        unless `divisible` is true.
    UsageError: the file has no sound or cannot be read, or its format is not supported.
    """

    def __init__(self, path: Path, blocksize: int = BLOCKSIZE_FRAMES, *, first: int = 0) -> None:
        self.path = path
        self._blocksize = blocksize
        self._file = _open(path)
        frames, format_ = int(self._file.frames), (self._file.samplerate, self._file.channels)
        expected = frames if 0 < frames < FRAMES_UNKNOWN else None
        try:
            if first:
                try:
                    self._file.seek(first)
                except (soundfile.LibsndfileError, RuntimeError) as error:
                    raise UsageError(f"{path} has no frame {first} ({reason_of(error)})") from None
            check_format(*format_)
            super().__init__(*format_, self._decoded(first, expected), expected)
            if self._next is None:
                raise UsageError(f"{path} has no sound (0 frames); give a file with sound in it")
        except UsageError as error:
            self.close()
            raise named(error, path) from None

    @property
    def divisible(self) -> bool:
        """Whether reading can start at any frame without a change of the samples."""
        return self._file.format in EXACT_FORMATS and self._file.subtype in EXACT_SUBTYPES

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _decoded(self, first: int, expected: int | None) -> Iterator[Float32Array]:
        """Yield buffers up to the end or the first damaged frame."""
        delivered = first
        while len(buffer := self._read()):
            delivered += len(buffer)
            yield buffer
            if self.warnings:  # the frame after this buffer cannot be decoded
                return
        missing = expected is not None and delivered < expected
        if not self.warnings and (missing or _body_is_short(self._file.extra_info)):
            self.warnings.append(
                f"{self.path} is shorter than its header says; "
                f"the {delivered} frames that are there were taken"
            )

    def _read(self) -> Float32Array:
        buffer = np.empty((self._blocksize, self.channels), np.float32)
        before = self._file.tell()
        try:
            filled: Float32Array = self._file.read(out=buffer)
            return filled
        except (soundfile.LibsndfileError, RuntimeError) as error:
            self.warnings.append(f"{self.path} is damaged ({reason_of(error)}); taken up to there")
            return buffer[: max(0, self._file.tell() - before)]


def _open(path: Path) -> soundfile.SoundFile:
    try:
        # Given a name instead of a descriptor, libsndfile would read text files *.vox as sound.
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except (FileNotFoundError, NotADirectoryError):
        raise UsageError(f"{path} does not exist; give the path of a sound file") from None
    except PermissionError:
        raise UsageError(f"{path} may not be read; check its permissions") from None
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} cannot be opened ({reason_of(error)})") from None
    kind = os.fstat(descriptor)
    try:
        if stat.S_ISDIR(kind.st_mode):
            raise UsageError(f"{path} is a folder; give the path of a sound file")
        if not stat.S_ISREG(kind.st_mode):
            raise UsageError(f"{path} is not a regular file; give the path of a sound file")
        if kind.st_size == 0:
            raise UsageError(f"{path} is empty (0 bytes); give the path of a sound file")
        with _quiet_decoder():
            return soundfile.SoundFile(descriptor, closefd=True)
    except UsageError:
        os.close(descriptor)
        raise
    except (soundfile.LibsndfileError, OSError, TypeError, ValueError) as error:
        raise UsageError(
            f"{path} is not a sound file that can be read ({reason_of(error)}); "
            "allowed: WAV, FLAC, Ogg, MP3, AIFF and other formats of libsndfile; the sound of a "
            "film becomes one by `ffmpeg -i FILM sound.wav`"
        ) from None


@contextmanager
def _quiet_decoder() -> Iterator[None]:
    """Suppress messages of decoders on stderr. The raised error has the same information."""
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


PROMISES = (  # patterns in libsndfile's log of a file that is shorter than its header says
    r"^\s*(?:data|SSND|Data Size|riff)\s*:\s*(?P<promised>\d+) \(should be (?P<there>\d+)\)",
    r"frame count (?P<there>\d+) does not match value from 'ds64' chunk of (?P<promised>\d+)",
)

UNKNOWN_LENGTH = 0xFFFF_0000  # from here to 4 GB: written by recorders that do not know the length


def _body_is_short(log: str) -> bool:
    for pattern in PROMISES:
        if found := re.search(pattern, log, re.MULTILINE):
            promised, there = int(found["promised"]), int(found["there"])
            return there < promised and not UNKNOWN_LENGTH <= promised < 1 << 32
    return re.search(r"Ogg\s*: (Last page lacks|Junk after the last page)", log) is not None


class FramesTap(SteadyTap):
    """A tap of frames in memory. frames: (n, channels). samplerate: Hz. blocksize: in frames."""

    def __init__(self, frames: Float32Array, samplerate: int, blocksize: int) -> None:
        starts = range(0, len(frames), blocksize)
        buffers = (frames[first : first + blocksize] for first in starts)
        super().__init__(samplerate, frames.shape[1], buffers, len(frames))


class CaptureTap:
    """A `Tap` that reads a capture from disk, in its original buffers and formats.

    folder: folder of the capture.
    time_s: time of delivery of the last buffer, in seconds of the recorder's monotonic clock.
    warnings: lines for the user, complete after `read` has returned None.
    facts: settings that the recorder stored, by name.
    UsageError: the folder is not a readable capture, has no sound, or has a format that the
        transform does not support. `read` may raise it, too, after a change of the format.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._capture = Capture(folder)
        self._buffers = self._capture.buffers("tap")
        self._next: CaptureBuffer | None = next(self._buffers, None)
        self.warnings = self._capture.warnings
        self.facts = self._capture.facts
        self.frames_expected = self._capture.frames_expected("tap")
        if self._next is None or not self.frames_expected:
            self.close()
            why = "".join(f" ({text})" for text in self.warnings)
            raise UsageError(f"{folder} has no sound (0 frames){why}; give one with sound in it")
        self.samplerate, self.channels = self._next.format
        self._check_format()
        self.format_changed = False
        self.discontinuity = self._next.discontinuity
        self.time_s = self._next.time_s

    def read(self) -> Float32Array | None:
        """Return the next buffer, or None at the end."""
        buffer = self._next or next(self._buffers, None)
        self._next = None
        if buffer is None:
            return None
        self.format_changed = buffer.format != (self.samplerate, self.channels)
        self.discontinuity = buffer.discontinuity
        self.time_s = buffer.time_s
        if self.format_changed:
            self.samplerate, self.channels = buffer.format
            self._check_format()
        return buffer.frames

    def close(self) -> None:
        """Close the capture."""
        self._next = None
        self._buffers.close()

    def _check_format(self) -> None:
        try:
            check_format(self.samplerate, self.channels)
        except UsageError as error:
            self.close()
            raise named(error, self.folder) from None
