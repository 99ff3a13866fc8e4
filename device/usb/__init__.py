"""USB audio devices: which there are, which one is meant, and whether it is still there.

    sysfs.py --> identity.py --> mapping.py        what is there, its name, its cards and sinks
        `------> presence.py, uevents.py           what comes and goes
        `------> pyusb_access.py                   what only the device itself can tell
    descriptors/                                   what it says that it is, from raw bytes

`find_devices` needs neither permission nor library. PyUSB is imported only when something is asked
of a device that the kernel does not tell; no driver is ever detached here, since that would take
the sound card away from whoever plays on it.
"""

from device.usb.errors import NoLibusbError, NoUsbBusError, NoUsbDeviceError, UsbAccessError
from device.usb.identity import UsbIdentity, find_again, find_one, identify, matching
from device.usb.sysfs import AlsaCard, AudioInterface, Found, UsbAudioDevice, find_devices

__all__ = [
    "AlsaCard",
    "AudioInterface",
    "Found",
    "NoLibusbError",
    "NoUsbBusError",
    "NoUsbDeviceError",
    "UsbAccessError",
    "UsbAudioDevice",
    "UsbIdentity",
    "find_again",
    "find_devices",
    "find_one",
    "identify",
    "matching",
]
