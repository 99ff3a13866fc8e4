"""A tap on a sound file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import soundfile
from numpy.typing import NDArray

from audioflinger_hook.transform.parameters import check_format
from device.errors import UsageError

BLOCKSIZE_FRAMES = 32_768
"""Long enough that the cost of a call vanishes, short enough that 64 channels take 8 MB."""

FRAMES_UNKNOWN = 1 << 40
"""libsndfile gives a number like this for a stream whose header does not say its length."""


class FileTap:
    """The frames of any file that libsndfile reads, as float32, in buffers of `blocksize`.

    `warnings` holds, once the end is reached, what a user should know: one line each.

    Raises
    ------
    UsageError
        The file is missing, unreadable, not sound, holds no frame, or has a rate or a channel
        count that the transform does not take.
    """

    def __init__(self, path: Path, blocksize: int = BLOCKSIZE_FRAMES) -> None:
        self.path = path
        self.warnings: list[str] = []
        self._blocksize = blocksize
        self._file = _open(path)
        self.samplerate: int = self._file.samplerate
        self.channels: int = self._file.channels
        self._delivered = 0
        try:
            check_format(self.samplerate, self.channels)
            # The header may promise what is not there: only a first buffer proves sound.
            self._next = self._read()
            if not len(self._next):
                raise UsageError(f"{path} holds no sound (0 frames); give a file with sound in it")
        except UsageError as error:
            self.close()
            if str(path) in str(error):
                raise
            raise UsageError(f"{path}: {error}") from None

    @property
    def frames_expected(self) -> int | None:
        """Frames that the header promises, or None where it does not say."""
        frames = int(self._file.frames)
        return frames if 0 < frames < FRAMES_UNKNOWN else None

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

    def _read(self) -> NDArray[np.float32]:
        try:
            return np.asarray(
                self._file.read(self._blocksize, dtype="float32", always_2d=True), np.float32
            )
        except (soundfile.LibsndfileError, RuntimeError) as error:
            self.warnings.append(f"{self.path} is damaged ({_reason(error)}); taken up to there")
            return np.zeros((0, self.channels), np.float32)

    def _note_short_body(self) -> None:
        if self.warnings:
            return
        expected = self.frames_expected
        promised = _promised_bytes(self._file.extra_info)
        if promised or (expected is not None and self._delivered < expected):
            self.warnings.append(
                f"{self.path} is shorter than its header says; "
                f"the {self._delivered} frames that are there were taken"
            )


def _open(path: Path) -> soundfile.SoundFile:
    """Return the opened file, or say what is wrong with it."""
    if not path.exists():
        raise UsageError(f"{path} does not exist; give the path of a sound file")
    if path.is_dir():
        raise UsageError(f"{path} is a folder; give the path of a sound file")
    if path.is_file() and path.stat().st_size == 0:
        raise UsageError(f"{path} is empty (0 bytes); give the path of a sound file")
    try:
        with path.open("rb"):
            pass
        return soundfile.SoundFile(path)
    except PermissionError:
        raise UsageError(f"{path} may not be read; check its permissions") from None
    except (soundfile.LibsndfileError, OSError, TypeError, ValueError) as error:
        raise UsageError(
            f"{path} is not a sound file that can be read ({_reason(error)}); "
            "WAV, FLAC, Ogg, MP3, AIFF and others that libsndfile reads will do"
        ) from None


def _reason(error: Exception) -> str:
    text = getattr(error, "error_string", None) or str(error)
    return str(text).strip().rstrip(".")


def _promised_bytes(log: str) -> bool:
    """Return whether libsndfile's log of a RIFF file notes a data chunk longer than the file.

    Lengths of 4 GB are what a recorder writes when it cannot know better, and promise nothing.
    """
    found = re.search(r"^\s*data\s*:\s*(\d+) \(should be (\d+)\)", log, re.MULTILINE)
    return found is not None and int(found[2]) < int(found[1]) < 0xFFFF_0000
