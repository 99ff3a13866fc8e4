"""The messages that ALSA, JACK, PortAudio and libpulse print by themselves, kept from the terminal.

They print through C's `stderr`, Python through file descriptor 2. So C's `stderr` is led to
/dev/null and nothing else changes: Python's messages, tracebacks, faulthandler, warnings and child
processes write where they always did. What the libraries have to say reaches the caller as errors.
"""

from __future__ import annotations

import ctypes
import os
import platform
import threading

_lock = threading.Lock()
_terminal: int | None = None
"""The libraries' own stream while it is replaced."""


def filter_stderr() -> bool:
    """Keep C libraries from printing; whether that can be done here (it takes the GNU C library).

    From now on, for the whole process; a second call changes nothing. What is lost with the noise
    is the text of a failed C assertion or a fatal error of the interpreter: leave this out while
    debugging. Any thread may call it; it raises nothing.
    """
    global _terminal
    with _lock:
        if _terminal is not None:
            return True
        stream = _stream()
        if stream is None:
            return False
        libc = ctypes.CDLL(None)
        libc.fopen.restype = ctypes.c_void_p
        nowhere = libc.fopen(os.devnull.encode(), b"we")
        if not nowhere:
            return False
        _terminal, stream.value = stream.value, nowhere
        return _terminal is not None


def restore_stderr() -> None:
    """Let C libraries print again. Any thread may call it; it raises nothing.

    The replaced stream stays open: a thread of a library may be about to write to it.
    """
    global _terminal
    with _lock:
        stream = _stream()
        if stream is not None and _terminal is not None:
            stream.value = _terminal
        _terminal = None


def _stream() -> ctypes.c_void_p | None:
    """C's variable `stderr`; None where it is a constant, as in other C libraries than GNU's."""
    if platform.libc_ver()[0] != "glibc":
        return None
    try:
        return ctypes.c_void_p.in_dll(ctypes.CDLL(None), "stderr")
    except (OSError, ValueError):
        return None
