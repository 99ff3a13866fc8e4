"""Child processes that end with this program, and function calls in such a process."""

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

LIMIT_S = 30.0  # longest time for one call

_COMMAND = "import sys; sys.path[:] = {path!r}; from device.process import answer; answer()"

_PR_SET_PDEATHSIG, _MFD_CLOEXEC = 1, 1
_LIBC = ctypes.CDLL(None, use_errno=True)  # some Python builds lack `os.memfd_create`


def ends_with_us() -> None:
    """As a `preexec_fn`: let Linux kill this process when the thread that started it ends."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def memory_file(name: str) -> int:
    """Return the descriptor of a new file in memory, which child processes do not inherit."""
    if (number := _LIBC.memfd_create(name.encode(), _MFD_CLOEXEC)) < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return int(number)


def started(
    command: Sequence[str], *, stdin: int = subprocess.DEVNULL, stdout: int = subprocess.DEVNULL
) -> subprocess.Popen[bytes]:
    """Start a program that Ctrl-C does not interrupt, and that is killed when this program ends.

    Only the main thread may call it, see `ends_with_us`. OSError: the program cannot be started.
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
            with suppress(OSError):  # the program did not read everything
                pipe.close()


class Call(Generic[Result]):
    """One function call in a separate process; the end of the process frees its memory.

    Only the main thread may use it, see `ends_with_us`. what: name of the result for messages.
    now_s: present time in s. function: must be defined at module level. arguments: its arguments;
    arguments and result must be picklable. LostError: the process cannot be started.
    """

    def __init__(
        self, what: str, now_s: float, function: Callable[..., Result], *arguments: Any
    ) -> None:
        self._what = what
        self._until_s = now_s + LIMIT_S
        self._is_late = False
        self._files: list[int] = []
        try:
            # Files in memory need no reader while the process writes, unlike pipes.
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
        """Return whether the process has ended. After LIMIT_S, kill the process."""
        if now_s > self._until_s and self._process.poll() is None:
            end(self._process)
            self._is_late = True
        return self._process.poll() is not None

    def result(self) -> Result:
        """Wait for the result and return it. Raises LostError, or the function's CushionError."""
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
        except Exception as fault:  # something else has written to the file
            raise LostError(f"{self._what} cannot be computed: no answer ({fault})") from fault
        if isinstance(error, LostError):
            raise LostError(f"{self._what} cannot be computed: {error}")
        if error is not None:
            raise error
        return cast(Result, result)

    def close(self) -> None:
        """Kill the process. May be repeated; raises nothing."""
        end(self._process)
        self._close_files()

    def _close_files(self) -> None:
        while self._files:
            os.close(self._files.pop())


def answer() -> None:
    """In the child process, call the function read from stdin; write result or error to stdout."""
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
