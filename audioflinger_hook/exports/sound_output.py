"""Sound files that libsndfile encodes, complete or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import soundfile

from device.atomic_file import AtomicFile
from device.errors import InternalError, UsageError, WriteError
from device.units import Float32Array, FloatArray, check_channels

BLOCK_FRAMES = 4_096
"""Frames encoded at once. Encoders get blocks of one size, so that a file's bytes do not depend on
the caller's blocks, and the Vorbis encoder's stack stays small."""


class LibsndfileTarget:
    """The file object that libsndfile writes to; it keeps the reason of a failure.

    UsageError, WriteError: as `AtomicFile`.
    """

    def __init__(self, path: Path) -> None:
        self.file = AtomicFile(path)
        self._position = self._size = 0
        self.failure: WriteError | None = None

    def write(self, content: bytes) -> int:
        """Write at the position; called by libsndfile, which would swallow an exception."""
        if self.failure is None:
            try:
                self._store(bytes(content))
            except WriteError as failure:
                self.failure = failure
        return len(content)

    def _store(self, content: bytes) -> None:
        over = content[: self._size - self._position]
        if over:
            self.file.overwrite(over, self._position)
        if rest := content[len(over) :]:
            self.file.write(rest)
        self._position += len(content)
        self._size = max(self._size, self._position)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the position; return it."""
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}[whence]
        self._position = min(max(0, start + offset), self._size)
        return self._position

    def tell(self) -> int:
        """Return the position."""
        return self._position

    def read(self, _count: int = -1) -> bytes:
        """Return nothing: an encoder reads nothing back."""
        return b""

    def commit(self) -> None:
        """Give the file its name."""
        self.file.commit()


class SoundFileOutput:
    """A `VibrationOutput` that writes a FLAC or Ogg Vorbis file. Use from one thread.

    Samples beyond ±1.0 are limited and counted.

    format, subtype: libsndfile's names, such as "FLAC" and "PCM_24". target: takes the encoded
    bytes; default: the file. level: compression, 0 to 1; default: libsndfile's.
    UsageError: the format does not allow the rate or the channels, or the file cannot be created.
    WriteError: the disk is full or failed, here or later; no file is left then.
    """

    def __init__(
        self,
        path: Path,
        samplerate: int,
        channels: int,
        format: str,
        subtype: str,
        *,
        target: LibsndfileTarget | None = None,
        level: float | None = None,
    ) -> None:
        self.samplerate, self.channels = samplerate, channels
        self.frames = self.limited_samples = 0
        self._held = np.zeros((0, channels), np.float32)
        self._target = target or LibsndfileTarget(path)
        self._file: soundfile.SoundFile | None = None
        try:
            wanted = {"subtype": subtype, "format": format, "compression_level": level}
            self._file = soundfile.SoundFile(self._target, "w", samplerate, channels, **wanted)
        except (soundfile.LibsndfileError, ValueError, TypeError) as error:
            self._target.file.abort()
            if self._target.failure:
                raise self._target.failure from None
            raise UsageError(
                f"{path}: {format} cannot hold {channels} channels at {samplerate} Hz ({error}); "
                "choose fewer channels, another --output-rate or the format wav"
            ) from None

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Append (frames, channels) samples."""
        if self._file is None:
            raise InternalError("the sound file is closed: nothing can be written to it")
        check_channels(vibration, self.channels)
        self._held = np.concatenate((self._held, vibration.astype(np.float32)))
        whole = len(self._held) - len(self._held) % BLOCK_FRAMES
        self._encode(whole)

    def close(self) -> None:
        """Encode the rest and give the file its name."""
        if self._file is None:
            return
        self._encode(len(self._held))
        file, self._file = self._file, None
        file.close()
        self._raise_failure()
        self._target.commit()

    def abort(self) -> None:
        """Discard the file."""
        file, self._file = self._file, None
        if file is not None:
            self._target.failure = self._target.failure or WriteError("aborted")
            file.close()
        self._target.file.abort()

    def _encode(self, frames: int) -> None:
        assert self._file is not None
        for first in range(0, frames, BLOCK_FRAMES):
            block = self._held[first : min(frames, first + BLOCK_FRAMES)]
            beyond = np.abs(block) > 1.0
            if beyond.any():
                self.limited_samples += int(beyond.sum())
                block = np.clip(block, -1.0, 1.0)
            try:
                self._file.write(block)
            except (soundfile.LibsndfileError, RuntimeError) as error:
                self._target.failure = WriteError(f"cannot encode the sound file ({error})")
            self.frames += len(block)
            self._raise_failure()
        self._held = self._held[frames:]

    def _raise_failure(self) -> None:
        if self._target.failure is not None:
            self.abort()
            raise self._target.failure
