"""Devices opened with PyUSB, and descriptors that /sys does not have.

Opening a device does not affect its driver or sound card. Requests take milliseconds, or seconds if
the device does not answer.
"""

from __future__ import annotations

import errno
from functools import cache
from typing import Any

from device.errors import NoLibusbError, NoUsbDeviceError, UsbAccessError, not_installed
from device.usb.sysfs import UsbAudioDevice

TIMEOUT_MS = 500  # of one request; devices answer within some ms or never

# types and lengths: USB 2.0, tables 9-5, 9-8 and 9-10
_DEVICE, _DEVICE_BYTES = 1, 18
_CONFIGURATION, _CONFIGURATION_BYTES = 2, 9


@cache
def libusb() -> Any:
    """Return PyUSB's backend. A process may have only one, so it is chosen once.

    NoLibusbError: there is none; the next call searches again.
    """
    try:
        from usb.backend import libusb1
    except ImportError:
        raise NoLibusbError(not_installed("PyUSB", "live")) from None
    backend = libusb1.get_backend()
    if backend is None:
        raise NoLibusbError(
            "no libusb: PyUSB is here, but not the library libusb-1.0; install it: "
            "sudo apt install libusb-1.0-0, or sudo dnf install libusb1"
        )
    return backend


def open_device(device: UsbAudioDevice) -> Any:
    """Return PyUSB's usb.core.Device of a device from `find_devices`.

    The first request opens it; usb.util.dispose_resources closes it.

    NoLibusbError: libusb is missing. NoUsbDeviceError: it does not see the device.
    """
    backend = libusb()
    import usb.core

    try:
        handle = usb.core.find(backend=backend, bus=device.bus, address=device.address)
    except usb.core.USBError as error:
        raise refusal(device, error) from None
    ids = (int(device.vendor_id, 16), int(device.product_id, 16))
    if handle is None or (handle.idVendor, handle.idProduct) != ids:
        raise NoUsbDeviceError(
            f"libusb does not see {device.label!r} at {device.node}, which the kernel shows; plug "
            "it in again; in a container, plug it in before the program starts, and pass on "
            "/dev/bus/usb"
        )
    return handle


def read_descriptors(device: UsbAudioDevice) -> bytes:
    """Return the device descriptor and all configurations, from /sys or else from the device.

    NoLibusbError, NoUsbDeviceError, UsbAccessError: both fail.
    """
    if device.descriptors:
        return device.descriptors
    handle = open_device(device)
    import usb.core
    import usb.util
    from usb.control import get_descriptor

    try:
        blocks = [bytes(get_descriptor(handle, _DEVICE_BYTES, _DEVICE, 0))]
        for index in range(handle.bNumConfigurations):
            head = bytes(get_descriptor(handle, _CONFIGURATION_BYTES, _CONFIGURATION, index))
            length = int.from_bytes(head[2:4], "little")  # wTotalLength
            blocks.append(bytes(get_descriptor(handle, length, _CONFIGURATION, index)))
    except usb.core.USBError as error:
        raise refusal(device, error) from None
    finally:
        usb.util.dispose_resources(handle)
    return b"".join(blocks)


def refusal(device: UsbAudioDevice, error: Any) -> UsbAccessError | NoUsbDeviceError:
    """Return the error to raise for an error of PyUSB."""
    what = f"{device.label!r} at {device.node}"
    if error.errno in (errno.ENODEV, errno.ENOENT):
        return NoUsbDeviceError(f"{what} was pulled out; plug it in again")
    if error.errno in (errno.EACCES, errno.EPERM):
        return UsbAccessError(
            f"no permission to open {what} (errno {error.errno}); `cushion install-service --udev` "
            'prints a udev rule (TAG+="uaccess") that gives the permission to the person at the '
            "machine; install it and plug the device in again"
        )
    if error.errno == errno.EBUSY:
        return UsbAccessError(f"{what} is held by a driver or another program (errno EBUSY)")
    if error.errno == errno.ETIMEDOUT:
        return UsbAccessError(f"{what} does not answer within {TIMEOUT_MS} ms; plug it in again")
    return UsbAccessError(f"{what} does not answer correctly ({error}); plug it in again")
