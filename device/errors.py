"""The errors that a user may see, and the exit code of a command for each error.

A message is one line. It states the mistake and, for a `UsageError`, the remedy. An exception of
any other class is a defect of the program, or a lack of memory.
"""

import os
import re
import resource

_NO_FOLDER = "No usable temporary directory"  # words of `tempfile`
_NO_MEMORY = re.compile(  # words of the loader, of `threading` and of the C library
    "failed to map segment|cannot map zero-fill|start new thread|Cannot allocate memory"
)


class CushionError(Exception):
    """Base class of all errors of this project; `str(error)` is always one line.

    exit_code: exit code of a command that ends with this error, 2 to 5.
    """

    exit_code = 5

    def __str__(self) -> str:
        # A path or a library's message may hold line breaks.
        return " ".join(super().__str__().split())


class UsageError(CushionError):
    """A wrong option, config file, rig file or input, which the user can correct."""

    exit_code = 2


class NotFoundError(CushionError):
    """A required device, sound source, library or daemon is missing or not accessible."""

    exit_code = 3


class LostError(CushionError):
    """The sound server, the device or a child process does not answer, was lost or failed."""

    exit_code = 4


class NoAnswerError(LostError):
    """The sound server accepts connections, but does not answer in time."""


class BrokenStreamError(LostError):
    """A stream broke off, for example because a block was late; a measurement may be repeated."""


class InternalError(CushionError):
    """The program failed at run time, for example because a file cannot be written."""


class WriteError(InternalError):
    """Writing a file failed, for example because the disk is full."""


def unexpected(error: Exception) -> CushionError:
    """Return the error that a user sees for an exception of another class."""
    said = f"{type(error).__name__}: {error}"
    if _NO_FOLDER in said:
        where = os.environ.get("TMPDIR", "not set")
        return UsageError(
            f"no folder for temporary files can be used; TMPDIR is {where}; name a usable folder"
        )
    if isinstance(error, MemoryError) or _NO_MEMORY.search(said):
        soft, _ = resource.getrlimit(resource.RLIMIT_AS)
        if soft < 0 and "start new thread" in said:
            return InternalError("no more threads can start; raise the limit of them (ulimit -u)")
        limit = f"raise the limit of {soft >> 20} MB (ulimit -v)" if soft > 0 else "add memory"
        return InternalError(f"no memory is left ({type(error).__name__}); {limit}")
    return InternalError(f"{said}; this is a fault of cushion, please report it")


class NoUsbBusError(NotFoundError):
    """The kernel shows no USB bus, for example in a container."""


class NoUsbDeviceError(NotFoundError):
    """The kernel shows a USB bus, but the wanted device is not on it."""


class NoLibusbError(NotFoundError):
    """PyUSB or the library libusb is not installed."""


class UsbAccessError(NotFoundError):
    """The USB device is connected, but it does not answer, is in use or needs a permission."""


def not_installed(package: str, extra: str) -> str:
    """Return a message that a package is missing, and the pip command that installs `extra`."""
    return f'{package} is not installed; install it: pip install "haptic-cushion[{extra}]"'
