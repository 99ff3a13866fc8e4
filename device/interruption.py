"""Interruptions that Python would lose: those that arrive while a destructor runs."""

import signal
import sys
from types import FrameType

AGAIN_S = 1e-3  # time until a lost interruption is raised again

_hook_before = sys.unraisablehook


def repeat_lost_interruptions() -> None:
    """Raise a KeyboardInterrupt again, shortly after a destructor or a callback of C lost it.

    Python would print it with its traceback, and the program would go on. The other exceptions of
    destructors are reported as before. It uses SIGALRM. Only the main thread may call it.
    """
    global _hook_before
    if sys.unraisablehook is not _repeat:
        _hook_before = sys.unraisablehook
        sys.unraisablehook = _repeat
    signal.signal(signal.SIGALRM, _interrupt)


def _repeat(lost: "sys.UnraisableHookArgs") -> None:
    if isinstance(lost.exc_value, KeyboardInterrupt):
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
    else:
        _hook_before(lost)


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
