"""Taps on stored sound: a file, frames in memory, a capture."""

from __future__ import annotations

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

BLOCKSIZE_FRAMES = 32_768
"""Frames per buffer: long enough to make the cost of a call negligible; 64 channels take 8 MB."""

EXACT_FORMATS = frozenset({"WAV", "WAVEX", "RF64", "W64", "AIFF", "AU", "CAF"})
EXACT_SUBTYPES = frozenset({"PCM_U8", "PCM_S8", "PCM_16", "PCM_24", "PCM_32", "FLOAT", "DOUBLE"})
"""Formats in which a frame's position in the file follows from the frame's number."""

FRAMES_UNKNOWN = 1 << 40  # from here, libsndfile does not know the length of a stream


class FileTap(SteadyTap):
    """The frames of any file that libsndfile reads, as float32.

    path: the file. blocksize: frames of a buffer. first: the frame to begin with; other than 0 only
    for a file that is `divisible`. UsageError: the file cannot be used, or the transform does not
    support its rate or channel count.
    """

    def __init__(self, path: Path, blocksize: int = BLOCKSIZE_FRAMES, *, first: int = 0) -> None:
        self.path = path
        self._blocksize = blocksize
        self._file = _open(path)
        frames, format_ = int(self._file.frames), (self._file.samplerate, self._file.channels)
        expected = frames if 0 < frames < FRAMES_UNKNOWN else None
        try:
            if first:
                self._skip_to(first)
            check_format(*format_)
            super().__init__(*format_, self._decoded(first, expected), expected)
            if self._next is None:
                raise UsageError(f"{path} has no sound (0 frames); give a file with sound in it")
        except UsageError as error:
            self.close()
            raise named(error, path) from None

    @property
    def divisible(self) -> bool:
        """Whether a part of the file, read alone, has the same frames as in the whole file."""
        return self._file.format in EXACT_FORMATS and self._file.subtype in EXACT_SUBTYPES

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _skip_to(self, frame: int) -> None:
        try:
            self._file.seek(frame)
        except (soundfile.LibsndfileError, RuntimeError) as error:
            raise UsageError(f"{self.path} has no frame {frame} ({reason_of(error)})") from None

    def _decoded(self, first: int, expected: int | None) -> Iterator[Float32Array]:
        """Yield the buffers from a frame on, up to the end or the first damage."""
        delivered = first
        while len(buffer := self._read()):
            delivered += len(buffer)
            yield buffer
            if self.warnings:  # no frames follow one that cannot be decoded
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
        # By descriptor, not by name: libsndfile would trust a name's ending and read text named
        # .vox as sound.
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
    """Hide what decoders print on stderr; our own error reports it."""
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


PROMISES = (
    r"^\s*(?:data|SSND|Data Size|riff)\s*:\s*(?P<promised>\d+) \(should be (?P<there>\d+)\)",
    r"frame count (?P<there>\d+) does not match value from 'ds64' chunk of (?P<promised>\d+)",
)
"""Lines in libsndfile's log if a WAV, AIFF, AU, W64 or RF64 body is shorter than promised."""

UNKNOWN_LENGTH = 0xFFFF_0000  # a recorder that does not know it writes this up to 4 GB


def _body_is_short(log: str) -> bool:
    for pattern in PROMISES:
        if found := re.search(pattern, log, re.MULTILINE):
            promised, there = int(found["promised"]), int(found["there"])
            return there < promised and not UNKNOWN_LENGTH <= promised < 1 << 32
    return re.search(r"Ogg\s*: (Last page lacks|Junk after the last page)", log) is not None


class FramesTap(SteadyTap):
    """Frames from memory. frames: (n, channels) float32. samplerate: Hz. blocksize: of a buffer."""

    def __init__(self, frames: Float32Array, samplerate: int, blocksize: int) -> None:
        starts = range(0, len(frames), blocksize)
        buffers = (frames[first : first + blocksize] for first in starts)
        super().__init__(samplerate, frames.shape[1], buffers, len(frames))


class CaptureTap:
    """The sound of a capture, buffer by buffer as delivered, with every change of format.

    A `Tap`, for the thread that steps the pipeline; reads are from disk.

    folder: the capture.
    time_s: delivery of the buffer read last, in seconds of the recorder's monotonic clock.
    warnings: for the user, one line each; complete once `read` has returned None.
    facts: settings that the recorder stored, by name.
    frames_expected: total frames in the capture's WAV files.
    UsageError: the folder is no readable capture or has no sound. `read` raises it, too, if the
        transform does not support the rate or channel count.
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
            raise UsageError(
                f"{folder} has no sound (0 frames){why}; give a capture with sound in it"
            )
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
