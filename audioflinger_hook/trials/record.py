"""A session of trials, and its record: one line of JSON a trial, appended, and synced to disk."""

import fcntl
import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, suppress
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol, TypeVar

from audioflinger_hook.capture.segment import write_at
from device.atomic_file import make_private_folder, write_reason
from device.errors import UsageError, WriteError

Trial = TypeVar("Trial", covariant=True)
Header = Mapping[str, Any] | None


def design_digest(design: Mapping[str, Any] | bytes) -> str:
    """Return the SHA-256 of a design's file, or of settings in any order, in hexadecimal digits."""
    if not isinstance(design, bytes):
        design = json.dumps(design, sort_keys=True, separators=(",", ":")).encode()
    return sha256(design).hexdigest()


class Rows:
    """The rows of a session, in memory. trials: in the order of answers. header: further facts."""

    def __init__(self, header: Header = None) -> None:
        self.trials: list[dict[str, Any]] = []
        self.header: dict[str, Any] = {**(header or {})}

    def append(self, trial: Mapping[str, Any]) -> None:
        """Keep one trial."""
        self.trials.append(dict(trial))


class TrialRecord(Rows, AbstractContextManager["TrialRecord"]):
    """An append-only file of trials, which one process may have open.

    Its first line is the header {"design": SHA-256, ...}. Half a line, which kill -9 leaves, is
    removed. design: `design_digest`. header: of a new file. fresh: drop earlier trials. UsageError:
    the file is damaged, of another design, in use, or cannot be opened. WriteError: disk full.
    """

    def __init__(
        self, path: Path, design: str = "", *, header: Header = None, fresh: bool = False
    ) -> None:
        super().__init__({"design": design, **(header or {})})
        self.path, self._length = path, 0
        make_private_folder(path.parent)
        try:
            flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
            self._file = os.fdopen(os.open(path, flags, 0o600), "r+b", buffering=0)
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self.close()
            busy = f"another cushion process has the record {path} open"
            raise UsageError(f"{busy}; end that process first") from error
        except OSError as error:
            raise UsageError(f"cannot open the record {path}: {write_reason(error)}") from error
        try:
            self._read(design, b"" if fresh else self._file.read())
        except BaseException:
            self.close()
            raise

    def append(self, trial: Mapping[str, Any]) -> None:
        """Write one trial, and wait until it is on the disk. WriteError: disk full; it is not."""
        self._write(trial)
        super().append(trial)

    def close(self) -> None:
        """Close the file and release its lock. May be repeated."""
        self._file.close()

    def __exit__(self, *_error: object) -> None:
        self.close()

    def _read(self, design: str, content: bytes) -> None:
        self._length = content.rfind(b"\n") + 1
        self._file.truncate(self._length)
        if not self._length:
            self._write(self.header)
            return
        try:
            rows = [dict(json.loads(line)) for line in content[: self._length].splitlines()]
        except (ValueError, TypeError, RecursionError) as error:
            damaged = f"the record {self.path} is damaged ({error})"
            raise UsageError(f"{damaged}; move it away, or remove the damaged line") from None
        self.header, *self.trials = rows
        if (found := self.header.get("design")) != design:
            raise UsageError(
                f"the record {self.path} belongs to another design (SHA-256 {str(found)[:12]}, "
                f"now {design[:12]}); restore that design, or begin a new record (fit: --new)"
            )

    def _write(self, row: Mapping[str, Any]) -> None:
        line = json.dumps(row, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
        content = f"{line}\n".encode()
        try:
            write_at(self._file.fileno(), content, self._length)
            os.fsync(self._file)
        except BaseException as error:  # even an interruption must not leave half a line
            with suppress(OSError):
                self._file.truncate(self._length)
            if not isinstance(error, OSError):
                raise
            raise WriteError(
                f"cannot write to the record {self.path}: {write_reason(error)}; "
                f"{len(self.trials)} trials are saved"
            ) from error
        self._length += len(content)


class Script(Protocol[Trial]):
    """Decides which trials a session has, from the rows so far."""

    def next_trial(self) -> tuple[Trial, Mapping[str, Any]] | None:
        """Return the next trial, and its columns for the record; None at the end."""

    def take(self, row: Mapping[str, Any]) -> None:
        """Take a recorded row: the columns of a trial, and those of its answer."""


def run(
    record: Rows,
    script: Script[Trial],
    answer: Callable[[Trial], Mapping[str, Any]],
    pause: Callable[[], None] = lambda: None,
) -> Iterator[Mapping[str, Any]]:
    """Yield each row after it is recorded. Trials that are recorded already are not repeated.

    answer: returns the columns of somebody's answer. pause: called before each later "block".
    """
    block = 1
    for row in record.trials:
        script.take(row)
        block = row.get("block", 1)
    while (chosen := script.next_trial()) is not None:
        trial, columns = chosen
        if columns.get("block", 1) > block:
            pause()
            block = columns["block"]
        row = {**columns, **answer(trial)}
        record.append(row)
        script.take(row)
        yield row
