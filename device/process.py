"""Child processes that end with the program that started them."""

from __future__ import annotations

import ctypes
import signal

_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True)


def ends_with_us() -> None:
    """Have the kernel end this process when its parent thread ends, however that happens (Linux).

    For `preexec_fn` of a process that the main thread starts: called in the child, before exec.
    """
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
