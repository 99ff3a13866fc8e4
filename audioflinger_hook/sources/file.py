"""A tap on a sound file."""

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
from numpy.typing import NDArray

from audioflinger_hook.transform.parameters import check_format
from device.errors import UsageError

BLOCKSIZE_FRAMES = 32_768
"""Frames per buffer: long enough to make the cost of a call negligible; 64 channels take 8 MB."""

EXACT_FORMATS = frozenset({"WAV", "WAVEX", "RF64", "W64", "AIFF", "AU", "CAF"})
EXACT_SUBTYPES = frozenset({"PCM_U8", "PCM_S8", "PCM_16", "PCM_24", "PCM_32", "FLOAT", "DOUBLE"})
"""Formats in which a frame's position in the file follows from the frame's number."""

FRAMES_UNKNOWN = 1 << 40
"""libsndfile reports such a number for a stream whose header does not state its length."""


class FileTap:
    """The frames of any file that libsndfile reads, as float32.

    Parameters
    ----------
    path : Path
        The file.
    blocksize : int
        Frames of a buffer.
    first : int
        The frame to begin with; other than 0 only for a file that is `divisible`.

    Attributes
    ----------
    warnings : list of str
        Warnings for the user, one line each; complete at the end of the file.

    Raises
    ------
    UsageError
        The file is missing, unreadable, not sound or empty, or the transform does not support
        its rate or channel count.
    """

    format_changed = False
    discontinuity = False

    def __init__(self, path: Path, blocksize: int = BLOCKSIZE_FRAMES, *, first: int = 0) -> None:
        self.path = path
        self.warnings: list[str] = []
        self._blocksize = blocksize
        self._file = _open(path)
        self.samplerate: int = self._file.samplerate
        self.channels: int = self._file.channels
        self._delivered = first
        try:
            if first:
                self._skip_to(first)
            check_format(self.samplerate, self.channels)
            # The header may promise frames that are missing: only a first buffer proves sound.
            self._next = self._read()
            if not len(self._next):
                raise UsageError(f"{path} has no sound (0 frames); give a file with sound in it")
        except UsageError as error:
            self.close()
            if str(path) in str(error):
                raise
            raise UsageError(f"{path}: {error}") from None

    @property
    def frames_expected(self) -> int | None:
        """Frames that the header promises, or None if the header has no number."""
        frames = int(self._file.frames)
        return frames if 0 < frames < FRAMES_UNKNOWN else None

    @property
    def divisible(self) -> bool:
        """Whether a part of the file, read alone, has the same frames as in the whole file."""
        return self._file.format in EXACT_FORMATS and self._file.subtype in EXACT_SUBTYPES

    def read(self) -> NDArray[np.float32] | None:
        """Return the next buffer, or None at the end."""
        buffer = self._next
        if not len(buffer):
            self._note_short_body()
            return None
        self._delivered += len(buffer)
        self._next = self._read()
        return buffer

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _skip_to(self, frame: int) -> None:
        try:
            self._file.seek(frame)
        except (soundfile.LibsndfileError, RuntimeError) as error:
            raise UsageError(f"{self.path} has no frame {frame} ({_reason(error)})") from None

    def _read(self) -> NDArray[np.float32]:
        if self.warnings:  # no frames follow one that cannot be decoded
            return np.zeros((0, self.channels), np.float32)
        buffer = np.empty((self._blocksize, self.channels), np.float32)
        before = self._file.tell()
        try:
            filled: NDArray[np.float32] = self._file.read(out=buffer)
            return filled
        except (soundfile.LibsndfileError, RuntimeError) as error:
            self.warnings.append(f"{self.path} is damaged ({_reason(error)}); taken up to there")
            return buffer[: max(0, self._file.tell() - before)]

    def _note_short_body(self) -> None:
        if self.warnings:
            return
        expected = self.frames_expected
        short = _body_is_short(self._file.extra_info)
        if short or (expected is not None and self._delivered < expected):
            self.warnings.append(
                f"{self.path} is shorter than its header says; "
                f"the {self._delivered} frames that are there were taken"
            )


def _open(path: Path) -> soundfile.SoundFile:
    """Return the opened file, or raise UsageError with what is wrong with it."""
    try:
        # By descriptor, not by name: libsndfile would trust a name's ending and read text named
        # .vox as sound.
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except (FileNotFoundError, NotADirectoryError):
        raise UsageError(f"{path} does not exist; give the path of a sound file") from None
    except PermissionError:
        raise UsageError(f"{path} may not be read; check its permissions") from None
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} cannot be opened ({_reason(error)})") from None
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
            f"{path} is not a sound file that can be read ({_reason(error)}); "
            "allowed: WAV, FLAC, Ogg, MP3, AIFF and other formats of libsndfile; the sound of a "
            "film becomes one by `ffmpeg -i FILM sound.wav`"
        ) from None


def _reason(error: Exception) -> str:
    text = getattr(error, "error_string", None) or getattr(error, "strerror", None) or str(error)
    return str(text).strip().rstrip(".") or type(error).__name__


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

UNKNOWN_LENGTH = 0xFFFF_0000
"""A recorder that does not know the length writes a length from here to 4 GB."""


def _body_is_short(log: str) -> bool:
    """Return whether libsndfile's log says that a file's body ends too early."""
    for pattern in PROMISES:
        if found := re.search(pattern, log, re.MULTILINE):
            promised, there = int(found["promised"]), int(found["there"])
            return there < promised and not UNKNOWN_LENGTH <= promised < 1 << 32
    return re.search(r"Ogg\s*: (Last page lacks|Junk after the last page)", log) is not None


class FramesTap:
    """Frames from memory, in buffers of `blocksize`; the last may be shorter.

    Parameters
    ----------
    frames : array of float32
        (frames, channels).
    samplerate : int
        Hz.
    blocksize : int
        Frames of a buffer.
    """

    format_changed = False
    discontinuity = False

    def __init__(self, frames: NDArray[np.float32], samplerate: int, blocksize: int) -> None:
        self._frames = frames
        self._blocksize = blocksize
        self._position = 0
        self.samplerate = samplerate
        self.frames_expected, self.channels = frames.shape

    def read(self) -> NDArray[np.float32] | None:
        """Return the next buffer, or None after the last."""
        first = self._position
        if first >= len(self._frames):
            return None
        self._position = first + self._blocksize
        return self._frames[first : self._position]

    def close(self) -> None:
        """Do nothing, as no resource is held."""
