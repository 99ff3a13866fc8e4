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


class OtherDesignError(UsageError):
    """A record belongs to another design."""


class Rows:
    """The rows of a session, in memory.

    trials: list of the trials, in the order of their answers. header: further facts, as a dict.
    """

    def __init__(self, header: Mapping[str, Any] | None = None) -> None:
        self.trials: list[dict[str, Any]] = []
        self.header: dict[str, Any] = {**(header or {})}

    def append(self, trial: Mapping[str, Any]) -> None:
        """Keep one trial."""
        self.trials.append(dict(trial))


class TrialRecord(Rows, AbstractContextManager["TrialRecord"]):
    """An append-only file of trials, which one process may have open.

    The first line is the header {"design": SHA-256, ...}; each further line is one trial. After
    kill -9 in the middle of a line, the next opening removes this line. All trials before are kept.

    path: the file; a missing file, and its folder, is made. design: the design's `design_digest`.
    header: further entries for the header of a new file; ignored for an existing file.

    OtherDesignError: the file belongs to another design. UsageError: the file cannot be opened, is
    no record, or another process has it open. WriteError: the header cannot be written.
    """

    def __init__(
        self, path: Path, design: str = "", *, header: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__({"design": design, **(header or {})})
        self.path = path
        make_private_folder(path.parent)
        try:
            self._fd = os.open(path, _FLAGS, 0o600)
        except OSError as error:
            raise UsageError(f"cannot open the record {path}: {write_reason(error)}") from error
        self._length = 0
        try:
            self._lock()
            self._read(design)
        except BaseException:
            self.close()
            raise

    def append(self, trial: Mapping[str, Any]) -> None:
        """Write one trial as a line, and wait until it is on the disk.

        trial: what JSON can hold, with finite numbers. WriteError: the disk is full, or the record
        is closed; the file then ends with the trial before, and `trials` does not have this one.
        """
        line = json.dumps(trial, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
        self._append(line)
        self.trials.append(json.loads(line))

    def close(self) -> None:
        """Close the file and release its lock. Repeated calls do nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __exit__(self, *_error: object) -> None:
        self.close()

    def _lock(self) -> None:
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UsageError(
                f"another cushion process has the record {self.path} open; end that process first"
            ) from error

    def _read(self, design: str) -> None:
        with open(self._fd, "rb", closefd=False) as file:
            content = file.read()
        whole, newline, _ = content.rpartition(b"\n")
        self._length = len(whole) + len(newline)
        if self._length != len(content):
            os.ftruncate(self._fd, self._length)
        if not whole:
            self._append(json.dumps(self.header, separators=(",", ":"), allow_nan=False))
            return
        header, *trials = (self._parsed(*one) for one in enumerate(whole.split(b"\n"), 1))
        if (found := header.get("design")) != design:
            raise OtherDesignError(
                f"the record {self.path} belongs to another design (SHA-256 {str(found)[:12]}, "
                f"now {design[:12]}); restore that design, or begin a new record"
            )
        self.header, self.trials = header, trials

    def _parsed(self, number: int, line: bytes) -> dict[str, Any]:
        with suppress(ValueError, RecursionError):
            parsed = json.loads(line)
            if isinstance(parsed, dict):
                return parsed
        raise UsageError(
            f"line {number} of the record {self.path} is damaged; "
            "move the file away, or remove this line"
        )

    def _append(self, line: str) -> None:
        if self._fd < 0:
            raise WriteError(f"the record {self.path} is closed: nothing can be written")
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
