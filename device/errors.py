"""The errors that a user may see, and the exit code each one ends a command with.

A message is one line: what is wrong, which value, what is allowed, what to do. Whatever is not a
`CushionError` is a mistake of the program.
"""

from __future__ import annotations


class CushionError(Exception):
    """The root of all errors of this project; `str()` of it is always one line.

    exit_code: what the command line ends with, 2 to 5.
    """

    exit_code = 5

    def __str__(self) -> str:
        # A path or a library's message may hold line breaks.
        return " ".join(super().__str__().split())


class UsageError(CushionError):
    """Wrong usage, config, rig or input: the user can put it right."""

    exit_code = 2


class NotFoundError(CushionError):
    """No such tap or device."""

    exit_code = 3


class LostError(CushionError):
    """The sound server or the device was lost and did not come back in the time allowed."""

    exit_code = 4


class InternalError(CushionError):
    """The program failed; the root of errors while it runs."""

    exit_code = 5


class WriteError(InternalError):
    """Writing failed while running: the disk is full, a quota or a file-size limit is reached."""


class NoUsbBusError(NotFoundError):
    """The kernel shows no USB bus here at all, as in a container."""


class NoUsbDeviceError(NotFoundError):
    """There is a bus, but the device that is wanted is not on it."""


class NoLibusbError(NotFoundError):
    """PyUSB, or the library libusb that it calls, is not installed."""


class UsbAccessError(NotFoundError):
    """The device is there, but it may not be opened or does not answer."""
