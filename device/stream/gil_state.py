"""Keeps Python's state of a library's thread between callbacks.

Python creates and frees a state for every call from a thread that it does not know. At some
hundred callbacks per second that costs as much as the callbacks.
"""

from __future__ import annotations

import ctypes
import threading

RELEASE_LIMIT_S = 0.05
"""Several callbacks: if none comes in this time, the stream has stopped."""

_LOCKED = 0
"""PyGILState_LOCKED of Python's C API: the caller already holds the lock, as in a callback."""

_ensure = ctypes.pythonapi.PyGILState_Ensure
_ensure.restype = ctypes.c_int
_release = ctypes.pythonapi.PyGILState_Release
_release.argtypes = [ctypes.c_int]
_release.restype = None


class GilState:
    """Python's state of the thread that calls one stream's callbacks.

    That thread calls `keep` and `release`, inside a callback. A stream that stops between two
    callbacks leaks the state, about 20 kB; `wait_released` avoids that.
    """

    def __init__(self) -> None:
        self._kept = False
        self._released = threading.Event()
        self._released.set()

    def keep(self) -> None:
        """Keep the state after this callback returns. Further calls do nothing."""
        if not self._kept:
            self._kept = True
            self._released.clear()
            _ensure()

    def release(self) -> None:
        """Let Python free the state after this callback and every later one."""
        if self._kept:
            self._kept = False
            _release(_LOCKED)
            self._released.set()

    def wait_released(self) -> bool:
        """Wait until released, RELEASE_LIMIT_S at most; whether it was. Any other thread."""
        return self._released.wait(RELEASE_LIMIT_S)
