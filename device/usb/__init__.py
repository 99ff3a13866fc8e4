"""USB audio devices: finding, naming, querying and setting them.

    sysfs.py                    devices, as the kernel lists them
    identity.py, mapping.py     their names, sound cards and sinks
    coils.py                    devices with coils on some channels only
    pyusb_access.py             opening a device with PyUSB
    control.py, requests.py     volume, mute and rate of a device without a driver
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
