"""Why a USB audio device cannot be found or opened: four reasons with four remedies.

An empty list would hide them: a container without a bus, a missing library, a missing permission
and an unplugged cable.
"""

from __future__ import annotations

from device.errors import NotFoundError


class NoUsbBusError(NotFoundError):
    """The kernel shows no USB bus here at all, as in a container."""


class NoUsbDeviceError(NotFoundError):
    """There is a bus, but the device that is wanted is not on it."""


class NoLibusbError(NotFoundError):
    """PyUSB, or the library libusb that it calls, is not installed."""


class UsbAccessError(NotFoundError):
    """The device is there, but it may not be opened or does not answer."""
