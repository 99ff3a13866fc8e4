"""Child processes that end with the program that started them."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
from collections.abc import Sequence
from contextlib import suppress

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
