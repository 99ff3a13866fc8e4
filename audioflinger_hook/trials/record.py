"""The record of a session: one line of JSON for each trial, appended and synced to the disk."""

import fcntl
import json
import os
from collections.abc import Mapping
from contextlib import AbstractContextManager, suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

from audioflinger_hook.capture.segment import write_at
from device.atomic_file import make_private_folder, write_reason
from device.errors import UsageError, WriteError

_FLAGS = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW


def design_digest(design: Mapping[str, Any] | bytes) -> str:
    """Return the SHA-256 of a design as hexadecimal digits.

    design: the bytes of the design's file, or settings, whose order does not count.
    """
    if not isinstance(design, bytes):
        design = json.dumps(design, sort_keys=True, separators=(",", ":")).encode()
    return sha256(design).hexdigest()


class Rows:
    """The rows of a session, in memory. trials: in the order of answers. header: further facts."""

    def __init__(self, header: Mapping[str, Any] | None = None) -> None:
        self.trials: list[dict[str, Any]] = []
        self.header: dict[str, Any] = {**(header or {})}

    def append(self, trial: Mapping[str, Any]) -> None:
        """Keep one trial."""
        self.trials.append(dict(trial))


class TrialRecord(Rows, AbstractContextManager["TrialRecord"]):
    """An append-only file of trials, which one process may have open.

    The first line is the header {"design": SHA-256, ...}; each further line is one trial. Half a
    line, which kill -9 leaves, is removed. path: the file, which is made if it is missing, with its
    folder. design: the design's `design_digest`. header: further entries of a new file's header.

    UsageError: the file is no record or one of another design, or cannot be opened, or another
    process has it open. WriteError: the header cannot be written.
    """

    def __init__(
        self, path: Path, design: str = "", *, header: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__({"design": design, **(header or {})})
        self.path, self._length = path, 0
        make_private_folder(path.parent)
        try:
            self._fd = os.open(path, _FLAGS, 0o600)
        except OSError as error:
            raise UsageError(f"cannot open the record {path}: {write_reason(error)}") from error
        try:
            self._read(design)
        except BaseException:
            self.close()
            raise

    def append(self, trial: Mapping[str, Any]) -> None:
        """Write one trial as a line, and wait until it is on the disk.

        trial: what JSON can hold, with finite numbers. WriteError: the disk is full; the file then
        ends with the trial before, and `trials` does not have this one.
        """
        self._append(trial)
        super().append(trial)

    def close(self) -> None:
        """Close the file and release its lock. Repeated calls do nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __exit__(self, *_error: object) -> None:
        self.close()

    def _read(self, design: str) -> None:
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            busy = f"another cushion process has the record {self.path} open"
            raise UsageError(f"{busy}; end that process first") from error
        with open(self._fd, "rb", closefd=False) as file:
            content = file.read()
        self._length = content.rfind(b"\n") + 1
        os.ftruncate(self._fd, self._length)
        if not self._length:
            self._append(self.header)
            return
        rows = []
        for number, line in enumerate(content[: self._length].splitlines(), 1):
            with suppress(ValueError, RecursionError):
                rows.append(json.loads(line))
            if len(rows) < number or not isinstance(rows[-1], dict):
                raise UsageError(
                    f"line {number} of the record {self.path} is damaged; move the file away, or "
                    "remove this line"
                )
        self.header, *self.trials = rows
        if (found := self.header.get("design")) != design:
            raise UsageError(
                f"the record {self.path} belongs to another design (SHA-256 {str(found)[:12]}, "
                f"now {design[:12]}); restore that design, or begin a new record"
            )

    def _append(self, row: Mapping[str, Any]) -> None:
        line = json.dumps(row, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
        content = f"{line}\n".encode()
        try:
            write_at(self._fd, content, self._length)
            os.fsync(self._fd)
        except BaseException as error:  # even an interruption must not leave half a line
            with suppress(OSError):
                os.ftruncate(self._fd, self._length)
            if not isinstance(error, OSError):
                raise
            raise WriteError(
                f"cannot write to the record {self.path}: {write_reason(error)}; "
                f"{len(self.trials)} trials are saved"
            ) from error
        self._length += len(content)
