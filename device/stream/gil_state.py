"""What Python holds for a thread that a library made, kept from one callback to the next.

Python prepares every call from a thread that it does not know, and tidies up behind it: it asks the
kernel for memory each time and gives it back. At a few hundred callbacks a second that costs as
much as the callbacks do.
"""

from __future__ import annotations

import ctypes
import threading

LET_GO_LIMIT_S = 0.05
"""Some callbacks long: one that does not come within it belongs to a stream that has stopped."""

_LOCKED = 0
"""PyGILState_LOCKED of Python's C interface: the caller holds the lock already, as here."""

_hold = ctypes.pythonapi.PyGILState_Ensure
_hold.restype = ctypes.c_int
_release = ctypes.pythonapi.PyGILState_Release
_release.argtypes = [ctypes.c_int]
_release.restype = None


class GilState:
    """The thread of one stream's callbacks, as long as that runs.

    `hold` and `let_go` are called by that thread, inside a callback. A stream that stops between
    two callbacks leaves what was held behind, some 20 kB: `wait` avoids that.
    """

    def __init__(self) -> None:
        self._held = False
        self._free = threading.Event()
        self._free.set()

    def hold(self) -> None:
        """Keep what Python holds for this thread when the callback returns. Once is enough."""
        if not self._held:
            self._held = True
            self._free.clear()
            _hold()

    def let_go(self) -> None:
        """Let Python tidy up after this callback and every other one."""
        if self._held:
            self._held = False
            _release(_LOCKED)
            self._free.set()

    def wait(self) -> bool:
        """Wait until it was let go, LET_GO_LIMIT_S at most; whether it was. Any other thread."""
        return self._free.wait(LET_GO_LIMIT_S)
