"""The errors that a user may see, and the exit code of a command for each error.

A message is one line. It states the mistake and, for a `UsageError`, the remedy. An exception of
any other class is a defect of the program.
"""


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
