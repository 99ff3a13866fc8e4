"""Child processes that end with the program that started them, and functions called in one."""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Generic, TypeVar, cast

from device.errors import CushionError, LostError

Result = TypeVar("Result")

LIMIT_S = 30.0  # longest time that a call may take

_COMMAND = "import sys; sys.path[:] = {path!r}; from device.process import answer; answer()"

_PR_SET_PDEATHSIG = 1
_MFD_CLOEXEC = 1
_LIBC = ctypes.CDLL(None, use_errno=True)


def ends_with_us() -> None:
    """Have the kernel end this process when its parent thread ends, however that happens (Linux).

    For `preexec_fn` of a process that the main thread starts: called in the child, before exec.
    """
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def memory_file(name: str) -> int:
    """Return the number of a new file in memory; no program that is started has it open.

    Some builds of Python lack `os.memfd_create`. OSError: the system makes none.
    """
    number = _LIBC.memfd_create(name.encode(), _MFD_CLOEXEC)
    if number < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return int(number)


def started(
    command: Sequence[str], *, stdin: int = subprocess.DEVNULL, stdout: int = subprocess.DEVNULL
) -> subprocess.Popen[bytes]:
    """Start a program that ends with us; the terminal's signals do not reach it.

    Only the main thread may call it, see `ends_with_us`. OSError: it cannot be run.
    """
    return subprocess.Popen(
        command,
        bufsize=0,
        stdin=stdin,
        stdout=stdout,
        stderr=subprocess.DEVNULL,
        preexec_fn=ends_with_us,
        process_group=0,
    )


def end(process: subprocess.Popen[bytes]) -> None:
    """Kill a program, wait for its end, and close our ends of its pipes. May be repeated."""
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):  # what it has not read is lost
                pipe.close()


class Call(Generic[Result]):
    """One call of a function in a separate process, whose memory goes when it ends.

    what: is computed, for messages. now_s: present time. function: of a module, not a lambda. It,
    arguments and result can be pickled. Only the main thread may use a call, see `ends_with_us`.

    LostError: no process can be started.
    """

    def __init__(
        self, what: str, now_s: float, function: Callable[..., Result], *arguments: Any
    ) -> None:
        self._what = what
        self._until_s = now_s + LIMIT_S
        self._is_late = False
        self._files: list[int] = []
        try:
            # files in memory, since a pipe would have to be read while the process writes
            for name in ("question", "answer"):
                self._files.append(memory_file(name))
            with open(self._files[0], "wb", closefd=False) as question:
                pickle.dump((function, arguments), question)
            os.lseek(self._files[0], 0, os.SEEK_SET)
            command = [sys.executable or "python3", "-c", _COMMAND.format(path=sys.path)]
            self._process = started(command, stdin=self._files[0], stdout=self._files[1])
        except OSError as error:
            self._close_files()
            raise LostError(f"{what} cannot be computed: {error}") from error

    def is_over(self, now_s: float) -> bool:
        """Return whether the process has ended; one that takes over LIMIT_S is ended."""
        if now_s > self._until_s and self._process.poll() is None:
            end(self._process)
            self._is_late = True
        return self._process.poll() is not None

    def result(self) -> Result:
        """Return what the function returned, once the call is over; close it.

        Raises the CushionError that the function raised. LostError: there is no result.
        """
        code = self._process.wait()
        os.lseek(self._files[1], 0, os.SEEK_SET)
        with open(self._files[1], "rb", closefd=False) as answered:
            answer = answered.read()
        self._close_files()
        if code:
            how = f"took over {LIMIT_S:g} s" if self._is_late else f"failed ({code})"
            raise LostError(f"{self._what} cannot be computed: the process {how}")
        try:
            result, error = pickle.loads(answer)
        except Exception as fault:  # something else has written there
            raise LostError(f"{self._what} cannot be computed: no answer ({fault})") from fault
        if isinstance(error, LostError):
            raise LostError(f"{self._what} cannot be computed: {error}")
        if error is not None:
            raise error
        return cast(Result, result)

    def close(self) -> None:
        """End the process. May be repeated; raises nothing."""
        end(self._process)
        self._close_files()

    def _close_files(self) -> None:
        while self._files:
            os.close(self._files.pop())


def answer() -> None:
    """Call the function that stdin names, and write its result to stdout: the process's part."""
    function, arguments = pickle.load(sys.stdin.buffer)
    answered: tuple[Any, CushionError | None]
    try:
        answered = function(*arguments), None
    except CushionError as error:
        answered = None, error
    except Exception as error:
        answered = None, LostError(f"{type(error).__name__}: {error}")
    with open(sys.stdout.fileno(), "wb", closefd=False) as answers:
        pickle.dump(answered, answers)
