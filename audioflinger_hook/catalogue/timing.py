"""The clock of a run, and retries of failed I/O after a delay."""

import errno
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from device.errors import CushionError

T = TypeVar("T")

BACK_OFF_S = 0.5  # delay before the second attempt; each later delay is 3 times the previous one

TRANSIENT = frozenset(  # errors of disks and networks that may be temporary
    getattr(errno, name)
    for name in (
        "EIO", "ESTALE", "ETIMEDOUT", "EAGAIN", "EBUSY", "ECONNRESET", "ECONNREFUSED",
        "ECONNABORTED", "ENETUNREACH", "EHOSTUNREACH", "EPIPE", "EREMOTEIO", "EINTR",
    )
)  # fmt: skip


class StorageError(CushionError):
    """A request to a remote storage failed; another attempt may succeed."""


class UnreadableError(StorageError):
    """A remote sound could not be read."""

    exit_code = 2


@dataclass(frozen=True)
class Timing:
    """A clock and a sleep function, both in seconds, and the number of retries of failed I/O."""

    clock: Callable[[], float]
    sleep: Callable[[float], None]
    retries: int = 3

    def repeated(self, action: Callable[[], T]) -> T:
        """Return the result of `action`. Retry up to `retries` times after temporary I/O errors."""
        pause_s = BACK_OFF_S
        for _ in range(self.retries):
            try:
                return action()
            except Exception as error:
                passing = (StorageError, TimeoutError, ConnectionError)
                is_known = any(isinstance(one, passing) for one in _chain(error))
                if not (is_known or has_errno(error, *TRANSIENT)):
                    raise
            self.sleep(pause_s)
            pause_s *= 3.0
        return action()


def has_errno(error: BaseException | None, *numbers: int) -> bool:
    """Return whether an error, or one of its causes, has one of these errno values."""
    return any(isinstance(one, OSError) and one.errno in numbers for one in _chain(error))


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
