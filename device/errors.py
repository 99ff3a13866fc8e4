"""The errors that a user may see, and the exit code of a command for each error.

A message is one line: the mistake, the value, the allowed values, the remedy. Any exception that
is no `CushionError` is a mistake of the program.
"""

from __future__ import annotations


class CushionError(Exception):
    """Base class of all errors of this project; `str(error)` is always one line.

    exit_code: exit code of the command line, 2 to 5.
    """

    exit_code = 5

    def __str__(self) -> str:
        # A path or a library's message may hold line breaks.
        return " ".join(super().__str__().split())


class UsageError(CushionError):
    """Wrong usage, config, rig or input, which the user can correct."""

    exit_code = 2


class NotFoundError(CushionError):
    """No such tap or device."""

    exit_code = 3


class LostError(CushionError):
    """The sound server or the device was lost and did not return in the time allowed."""

    exit_code = 4


class InternalError(CushionError):
    """The program failed; base class of errors at run time."""


class WriteError(InternalError):
    """Writing failed: the disk is full, or a quota or a file-size limit is reached."""


class NoUsbBusError(NotFoundError):
    """The kernel shows no USB bus, for example in a container."""


class NoUsbDeviceError(NotFoundError):
    """There is a USB bus, but the wanted device is not on it."""


class NoLibusbError(NotFoundError):
    """PyUSB, or the library libusb that it calls, is not installed."""


class UsbAccessError(NotFoundError):
    """The device is connected, but cannot be opened (permission) or does not answer."""


def not_installed(package: str, extra: str) -> str:
    """Return the message that a package is missing, and which extra of this one brings it."""
    return f'{package} is not installed; install it: pip install "haptic-cushion[{extra}]"'
