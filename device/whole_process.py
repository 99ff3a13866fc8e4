"""The process under a limit of memory (`ulimit -v`), and interruptions that Python would lose.

OpenBLAS needs a buffer of 32 MB. If there is no memory for it, NumPy's OpenBLAS ends the process,
and that of SciPy tries again for ever. Thus both get their buffer as soon as they are loaded.
"""

import contextlib
import ctypes
import os
import resource
import signal
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

from device.errors import UsageError

M_ARENA_MAX = -8  # of glibc's malloc.h

# Address space that a process needs to load NumPy, to multiply matrices, and to load SciPy.
NUMPY_MB, MATRICES_MB, SCIPY_MB = 120, 165, 310


class _SciPyFinder:
    """An entry of `sys.meta_path`: SciPy's OpenBLAS is refused, or gets its buffer at once."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None, *_: object) -> ModuleSpec | None:
        if name not in ("scipy.linalg", "scipy.special"):  # they load OpenBLAS
            return None
        _refuse_under(SCIPY_MB)
        spec = PathFinder.find_spec(name, path)
        if name == "scipy.linalg" and spec and (loader := spec.loader):
            execute = loader.exec_module

            def execute_and_allocate(module: ModuleType) -> None:
                execute(module)
                module.lapack.dgetrf([[1.0]])

            loader.exec_module = execute_and_allocate  # type: ignore[method-assign]
        return spec


def respect_memory_limit(needed_mb: int = MATRICES_MB) -> None:
    """Use less memory if it is limited. UsageError: the limit is too low; later, also for SciPy."""
    if resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY:
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # each thread takes memory
    with contextlib.suppress(AttributeError):  # only glibc has it
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)  # so does each arena
    _refuse_under(needed_mb)
    if needed_mb < MATRICES_MB or _SciPyFinder in sys.meta_path:
        return
    sys.meta_path.insert(0, _SciPyFinder)
    import numpy as np

    np.linalg.inv(np.eye(1))


def _refuse_under(needed_mb: int) -> None:
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit < needed_mb << 20:
        few = f"this process may use {limit >> 20} MB of memory (ulimit -v)"
        raise UsageError(f"{few}; allowed: at least {needed_mb} MB; raise the limit")


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
    signal.signal(signal.SIGALRM, signal.default_int_handler)


def _repeat(lost: "sys.UnraisableHookArgs") -> None:
    if isinstance(lost.exc_value, KeyboardInterrupt):
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
    else:
        _hook_before(lost)
