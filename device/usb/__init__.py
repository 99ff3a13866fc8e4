"""USB audio devices: finding, naming, querying and setting them.

    sysfs.py                    devices, as the kernel lists them
    identity.py, mapping.py     their names, coils, sound cards and sinks
    control.py, requests.py     a device opened with PyUSB: volume, mute and rate
    take_over.py, guardian.py   taking a device from its driver, and giving it back
    descriptors/                raw descriptors, decoded

`find_devices` needs neither a permission nor a library. PyUSB is imported only to send requests to
a device. Only take_over.py detaches a driver.
"""

from device.errors import NoLibusbError, NoUsbBusError, NoUsbDeviceError, UsbAccessError
from device.usb.identity import UsbIdentity, find_one, identify
from device.usb.sysfs import Found, UsbAudioDevice, find_devices

__all__ = [
    "Found",
    "NoLibusbError",
    "NoUsbBusError",
    "NoUsbDeviceError",
    "UsbAccessError",
    "UsbAudioDevice",
    "UsbIdentity",
    "find_devices",
    "find_one",
    "identify",
]
