"""Hides what ALSA, JACK, PortAudio and libpulse print.

They print through C's `stderr`, Python and child processes through file descriptor 2. So C's
`stderr` is replaced by /dev/null and nothing else changes.
"""

from __future__ import annotations

import ctypes
import os
import platform
import threading

_lock = threading.Lock()
_filtered = False


def filter_stderr() -> bool:
    """Stop C libraries from printing; whether this works here (it takes the GNU C library).

    It lasts for the whole process; further calls change nothing. It also hides failed C assertions
    and fatal errors of the interpreter, so do not call it while debugging. Any thread may call it.
    """
    global _filtered
    with _lock:
        stream = None if _filtered else _stream()
        if stream is not None:
            libc = ctypes.CDLL(None)
            libc.fopen.restype = ctypes.c_void_p
            if replacement := libc.fopen(os.devnull.encode(), b"we"):
                stream.value, _filtered = replacement, True
        return _filtered


def _stream() -> ctypes.c_void_p | None:
    """Return C's variable `stderr`; None if it is a constant, as outside the GNU C library."""
    if platform.libc_ver()[0] != "glibc":
        return None
    try:
        return ctypes.c_void_p.in_dll(ctypes.CDLL(None), "stderr")
    except (OSError, ValueError):
        return None
