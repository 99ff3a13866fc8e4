"""A child process that attaches a device's driver again when its parent ends or closes a pipe.

The process reads lines of JSON from standard input. At the end, it restores the settings in the
last complete line and attaches the driver. An error is printed as one line on standard output.
"""

import json
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from device.errors import CushionError, NoUsbDeviceError
from device.usb.control import ControlState, UsbControl, open_device, playback_of
from device.usb.sysfs import find_devices


def main() -> int:
    """Read the input and restore the device if it is present; return 1 after an error, else 0."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    wanted: dict[str, Any] | None = None
    for line in sys.stdin:
        with suppress(ValueError):  # the parent died while it wrote the last line
            wanted = json.loads(line)
    if wanted is None:
        return 0
    try:
        with suppress(NoUsbDeviceError):
            _give_back(wanted)
    except CushionError as error:
        print(error)
        return 1
    return 0


def _give_back(wanted: dict[str, Any]) -> None:
    devices = find_devices(Path(wanted["root"])).devices
    place = (wanted["port"], wanted["address"])
    device = next((one for one in devices if (one.port, one.address) == place), None)
    if device is None:  # unplugged; the kernel attaches the driver at the next plug-in
        return
    state = wanted["state"]
    handle = open_device(device)
    import usb.core
    import usb.util

    control = UsbControl(device, playback_of(device), handle)
    try:
        volumes, mutes = (tuple(map(tuple, state[name])) for name in ("volumes", "mutes"))
        control.restore(ControlState(volumes, mutes, state["samplerate"]))
    finally:
        control.close()
        for number in wanted["interfaces"]:
            # Attaching the driver to the first interface also attaches it to the others.
            with suppress(usb.core.USBError, NotImplementedError):
                if not handle.is_kernel_driver_active(number):
                    handle.attach_kernel_driver(number)
        usb.util.dispose_resources(handle)


if __name__ == "__main__":
    sys.exit(main())
