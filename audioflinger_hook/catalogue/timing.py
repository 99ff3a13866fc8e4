"""Time for the catalogue, as arguments, and repetition of I/O that failed."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from device.errors import CushionError

T = TypeVar("T")

BACK_OFF_S = 0.5  # before the second attempt; each later pause is three times as long

TRANSIENT = frozenset(
    getattr(errno, name)
    for name in (
        "EIO", "ESTALE", "ETIMEDOUT", "EAGAIN", "EBUSY", "ECONNRESET", "ECONNREFUSED",
        "ECONNABORTED", "ENETUNREACH", "EHOSTUNREACH", "EPIPE", "EREMOTEIO", "EINTR",
    )
)  # fmt: skip
"""Errors of disks and networks that may not come again."""


class StorageError(CushionError):
    """A remote storage refused or failed; another attempt may succeed."""


class UnreadableError(StorageError):
    """A remote sound could not be read."""

    exit_code = 2


@dataclass(frozen=True)
class Timing:
    """A clock in seconds, a way to wait for seconds, and the repetitions of failed I/O."""

    clock: Callable[[], float]
    sleep: Callable[[float], None]
    retries: int = 3

    def repeated(self, action: Callable[[], T]) -> T:
        """Return the action's result; after an error of I/O it is called again, after a pause."""
        pause_s = BACK_OFF_S
        for _ in range(self.retries):
            try:
                return action()
            except Exception as error:
                if not is_transient(error):
                    raise
            self.sleep(pause_s)
            pause_s *= 3.0
        return action()


def is_transient(error: BaseException | None) -> bool:
    """Return whether an error, or one that led to it, is an error of I/O that may pass."""
    passing = (StorageError, TimeoutError, ConnectionError)
    return any(isinstance(one, passing) for one in _chain(error)) or has_errno(error, *TRANSIENT)


def has_errno(error: BaseException | None, *numbers: int) -> bool:
    """Return whether an error, or one that led to it, has one of these numbers."""
    return any(isinstance(one, OSError) and one.errno in numbers for one in _chain(error))


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
