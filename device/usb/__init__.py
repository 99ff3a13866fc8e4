"""USB audio devices: functions that find, name, query and set them.

    sysfs.py                    devices, as the kernel lists them
    identity.py, mapping.py     their names, actuator channels, sound cards and sinks
    control.py, requests.py     a device opened with PyUSB: volume, mute and samplerate
    take_over.py, guardian.py   detaching a device's driver, and attaching it again
    descriptors/                decoding of descriptors

`find_devices` needs neither a permission nor a library. PyUSB is imported only to send requests to
a device. Only take_over.py detaches a kernel driver.
"""

from device.usb.identity import UsbIdentity, find_one, identify
from device.usb.sysfs import Found, UsbAudioDevice, find_devices

__all__ = ["Found", "UsbAudioDevice", "UsbIdentity", "find_devices", "find_one", "identify"]
