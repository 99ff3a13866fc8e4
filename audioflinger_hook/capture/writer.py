"""Writes a capture. All buffers written before a crash of the process remain."""

import errno
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from audioflinger_hook import __version__
from audioflinger_hook.capture import format as form
from audioflinger_hook.capture.format import INDEX_NAME, STREAMS, segment_name, segment_paths
from audioflinger_hook.capture.segment import SegmentWriter, write_at
from device.atomic_file import MACHINE_FAULTS, write_reason
from device.errors import CushionError, InternalError, UsageError, WriteError
from device.units import Float32Array


@dataclass
class _Stream:
    buffers: int = 0
    frames: int = 0
    segments: int = 0
    segment: SegmentWriter | None = None
    segment_frames: int = 0


class CaptureWriter(AbstractContextManager["CaptureWriter"]):
    """A new capture, written buffer by buffer.

    `write_buffer` passes the data to the operating system before it returns. `close` syncs the
    files to the disk. After a failed write, the writer is closed and the capture stays readable.
    The methods may wait for the disk. Only one thread, not the audio thread, may call them.

    folder: path of a new or empty folder. streams: names from `STREAMS`. facts: settings of the
    recording for the index, by name. UsageError: the folder is not empty, not writable, or cannot
    be created. WriteError: the disk is full or failed.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        *,
        streams: Sequence[str] = ("tap",),
        facts: form.Facts | None = None,
    ) -> None:
        if not streams or len(set(streams)) != len(streams) or not set(streams) <= set(STREAMS):
            raise InternalError(f"a capture cannot have streams={streams}; allowed: {STREAMS}")
        self.folder, self.streams = Path(folder), tuple(streams)
        self._streams = {stream: _Stream() for stream in streams}
        self._failure: WriteError | None = None
        program = f"haptic-cushion {__version__}"
        header = form.Header(streams=[*streams], facts={"program": program, **(facts or {})}).line()
        self._index_fd = _new_index(self.folder, header)
        self._index_bytes = len(header)

    def buffers(self, stream: str) -> int:
        """Return the number of buffers written to a stream."""
        return self._streams[stream].buffers

    def frames(self, stream: str) -> int:
        """Return the number of frames written to a stream."""
        return self._streams[stream].frames

    def write_buffer(
        self,
        stream: str,
        frames: Float32Array,
        samplerate: int,
        time_s: float,
        *,
        discontinuity: bool = False,
    ) -> None:
        """Write one buffer of float32, (frames, channels), unchanged. The buffer may be empty.

        A new sample rate or number of channels starts a new segment. samplerate: Hz. time_s: time
        of delivery in s, by a monotonic clock. discontinuity: frames before the buffer are missing.
        """
        check_frames(frames)
        if not math.isfinite(time_s):
            raise InternalError(f"time_s={time_s} of a buffer is not a number of seconds")
        before, here = self._state_of(stream), self._streams[stream]
        with self._all_or_nothing(stream, before):
            segment, wanted = here.segment, (samplerate, frames.shape[1])
            if segment is None or (segment.samplerate, segment.channels) != wanted:
                here.segments += 1
                path = self.folder / segment_name(stream, here.segments)
                here.segment = segment = SegmentWriter(path, *wanted)
                here.segment_frames = 0
            record = form.BufferRecord(
                stream=stream,
                buffer=here.buffers,
                segment=here.segments,
                first=here.segment_frames,
                frames=len(frames),
                samplerate=int(samplerate),
                channels=frames.shape[1],
                time_s=float(time_s),
                discontinuity=bool(discontinuity),
                samples_crc=segment.append(frames),
            )
            self._append_line(record.line())
            segment.keep(len(frames))
            here.buffers += 1
            here.frames += len(frames)
            here.segment_frames += len(frames)
        if before.segment is not None and before.segment is not segment:
            before.segment.close()

    def note_dropped(self, stream: str, buffers: int, frames: int) -> None:
        """Record dropped buffers in the index. frames: their total number of frames."""
        self._state_of(stream)
        with self._all_or_nothing():
            self._append_line(form.DroppedRecord(stream, buffers, frames).line())

    def close(self) -> None:
        """Sync all files and mark the capture as complete. Repeated calls do nothing."""
        if self._index_fd < 0:
            return
        try:
            with self._all_or_nothing():
                for stream in self._streams:
                    for path in segment_paths(self.folder, stream).values():
                        _fsync(path)
                counts = {stream: state.buffers for stream, state in self._streams.items()}
                self._append_line(form.EndRecord(counts).line())
                os.fsync(self._index_fd)
                with suppress(OSError):  # some file systems cannot sync folders
                    _fsync(self.folder)
        finally:
            self._release()

    def __exit__(self, *_error: object) -> None:
        self.close()

    def _state_of(self, stream: str) -> _Stream:
        """Return a copy of a stream's state. WriteError, InternalError: nothing can be written."""
        if self._failure is not None:
            raise WriteError(str(self._failure))
        if self._index_fd < 0:
            raise InternalError(f"the capture {self.folder} is closed: nothing can be written")
        if stream not in self._streams:
            raise InternalError(f"the capture has no stream {stream!r}, only {self.streams}")
        return replace(self._streams[stream])

    def _append_line(self, line: bytes) -> None:
        write_at(self._index_fd, line, self._index_bytes)
        self._index_bytes += len(line)

    @contextmanager
    def _all_or_nothing(self, stream: str = "", before: _Stream | None = None) -> Iterator[None]:
        """If the `with` block fails, undo its writes to the index and to the stream."""
        index_bytes = self._index_bytes
        try:
            yield
        except BaseException as error:  # even an interruption must not leave half a buffer
            self._index_bytes = index_bytes
            with suppress(OSError):  # the CRC reveals half a line
                os.ftruncate(self._index_fd, index_bytes)
            if before:
                started = self._streams[stream].segment
                if started is not None and started is not before.segment:
                    started.discard()
                if before.segment is not None:
                    before.segment.cut(before.segment_frames)
                self._streams[stream] = before
            if isinstance(error, OSError):
                self._failure = WriteError(
                    f"cannot write to the capture {self.folder}: {write_reason(error)}; "
                    "it can be replayed up to there"
                )
                self._release()
                raise self._failure from error
            raise

    def _release(self) -> None:
        for state in self._streams.values():
            if state.segment is not None:
                state.segment.close()
        if self._index_fd >= 0:
            os.close(self._index_fd)
            self._index_fd = -1


def check_frames(frames: Float32Array) -> None:
    """Raise InternalError unless the samples are float32 of shape (frames, channels)."""
    if frames.ndim != 2 or frames.dtype != np.float32:
        raise InternalError(
            f"a buffer of {frames.dtype} has shape {frames.shape}: "
            "(frames, channels) of float32 was expected"
        )


def _new_index(folder: Path, header: bytes) -> int:
    made = False
    try:
        try:
            folder.mkdir()
            made = True
        except FileExistsError:
            if not folder.is_dir():
                what = "not a folder; name another"
                raise UsageError(f"cannot capture to {folder}: {what}") from None
            if any(folder.iterdir()):
                what = "the folder is not empty; name a new one"
                raise UsageError(f"cannot capture to {folder}: {what}") from None
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        fd = os.open(folder / INDEX_NAME, flags, 0o666)
        try:
            write_at(fd, header, 0)
        except BaseException:
            os.close(fd)
            (folder / INDEX_NAME).unlink()
            raise
        return fd
    except (OSError, ValueError) as error:
        if made:
            with suppress(OSError):
                folder.rmdir()
        raise _folder_failure(folder, error) from error


def _folder_failure(folder: Path, error: OSError | ValueError) -> CushionError:
    if not isinstance(error, OSError):  # a name with a null byte
        return UsageError(f"cannot capture to {str(folder)!r}: {error}; choose another name")
    if error.errno in MACHINE_FAULTS | {errno.EFBIG}:
        return WriteError(f"cannot capture to {folder}: {write_reason(error)}")
    if isinstance(error, FileNotFoundError):
        return UsageError(
            f"cannot capture to {folder}: folder {folder.parent} does not exist; "
            "create it or name another"
        )
    if isinstance(error, PermissionError):
        return UsageError(f"cannot capture to {folder}: no permission to write there; name another")
    if isinstance(error, FileExistsError):
        return UsageError(f"cannot capture to {folder}: another capture began there; name another")
    return UsageError(f"cannot capture to {folder}: {write_reason(error)}")


def _fsync(path: Path) -> None:
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
