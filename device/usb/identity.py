"""Permanent names of USB devices, and the devices that they name. Pure functions.

A name consists of vendor id, product id and serial, and of the port if the serial is missing or
not unique. A name has no card number or bus address, which may change at the next plug-in.

A port is written as in the kernel: the number of the bus, then the port on each hub. A port keeps
its name after a reboot as long as the machine keeps its USB controllers.
"""

import re
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from operator import attrgetter

from device.errors import NotFoundError, NoUsbDeviceError, UsageError
from device.usb.sysfs import Found, UsbAudioDevice

GRAMMAR = "usb:VID:PID[:SERIAL][@PORT]"

_NAME = re.compile(
    r"(?P<vendor>[0-9a-fA-F]{4}):(?P<product>[0-9a-fA-F]{4})"
    r"(?::(?P<serial>.+?))?(?:@(?P<port>\d+-\d+(?:\.\d+)*))?"
)

# DualSense and DualSense Edge: channels 0 and 1 are speaker and headphones
_COILS = {("054c", "0ce6"): (2, 3), ("054c", "0df2"): (2, 3)}


@dataclass(frozen=True)
class UsbIdentity:
    """The name of a USB device.

    vendor_id, product_id: four hexadecimal digits each, converted to lower case. serial, port: ""
    matches any. UsageError: the parts do not form a valid name.
    """

    vendor_id: str
    product_id: str
    serial: str = ""
    port: str = ""

    def __post_init__(self) -> None:
        for name in ("vendor_id", "product_id"):
            object.__setattr__(self, name, getattr(self, name).lower())
        parts = _NAME.fullmatch(str(self).removeprefix("usb:"))
        if parts is None or (parts["serial"] or "") != self.serial:
            raise UsageError(f"a USB device is named {GRAMMAR}, which {str(self)!r} is not")

    def __str__(self) -> str:
        serial = f":{self.serial}" if self.serial else ""
        port = f"@{self.port}" if self.port else ""
        return f"usb:{self.vendor_id}:{self.product_id}{serial}{port}"

    @classmethod
    def parse(cls, text: str) -> "UsbIdentity":
        """Return the identity in a text, with or without "usb:". UsageError: wrong form."""
        if (parts := _NAME.fullmatch(text.removeprefix("usb:"))) is None:
            raise UsageError(
                f"device {text!r} is not {GRAMMAR} with four hexadecimal digits each for VID and "
                "PID, and a port such as 1-2 or 1-2.3"
            )
        return cls(parts["vendor"], parts["product"], parts["serial"] or "", parts["port"] or "")

    def is_device(self, device: UsbAudioDevice) -> bool:
        """Whether the name matches this device; it may match other devices, too."""
        if (self.vendor_id, self.product_id) != (device.vendor_id, device.product_id):
            return False
        if self.port not in ("", device.port):
            return False
        # the serial as the device, udev or a sound server writes it
        serial = udev_serial(device)
        vendor = _udev_form(device.manufacturer) or device.vendor_id
        model = _udev_form(device.product) or device.product_id
        others = (serial, f"{vendor}_{model}_{serial}") if serial else ()
        return self.serial in ("", device.serial, *others)


def identify(device: UsbAudioDevice, present: Iterable[UsbAudioDevice]) -> UsbIdentity:
    """Return a permanent name that no other present device has.

    device: if its serial is unique, its name is valid at every port, else only at the present port.
    present: all present devices, with or without this device.
    """
    bare = UsbIdentity(device.vendor_id, device.product_id)
    kind = attrgetter("vendor_id", "product_id", "serial")
    is_unique = all(other.port == device.port or kind(other) != kind(device) for other in present)
    if device.serial and is_unique:
        with suppress(UsageError):  # the end of the serial has the form of a port
            return replace(bare, serial=device.serial)
    return replace(bare, serial=device.serial, port=device.port)


def find_one(identity: UsbIdentity, found: Found) -> UsbAudioDevice:
    """Return the one present device that a name matches. identity: the name. found: all devices.

    NoUsbBusError, NoUsbDeviceError: the name matches no device; the message lists the present
    devices. NotFoundError: the name matches several; the message gives a unique name for each.
    """
    matches = [device for device in found.devices if identity.is_device(device)]
    if len(matches) == 1:
        return matches[0]
    if matches:
        raise NotFoundError(
            f"{identity} is not one device but {len(matches)}: "
            f"{_described(matches, found.devices)}; name one as written here"
        )
    if not found.devices and found.reason is not None:
        raise type(found.reason)(f"{identity} is missing: {found.reason}")
    raise NoUsbDeviceError(
        f"{identity} is missing: plug it in, or name one of "
        f"{_described(found.devices, found.devices)}"
    )


def _described(devices: Iterable[UsbAudioDevice], present: tuple[UsbAudioDevice, ...]) -> str:
    return ", ".join(
        f"{identify(device, present)} ({device.label}, port {device.port}"
        + "".join(f", card {card.number}" for card in device.cards)
        + ")"
        for device in devices
    )


def is_server_serial(known: str, serial: str) -> bool:
    """Whether a serial from a sound server equals or ends with a device's serial."""
    forms = filter(None, (serial, _udev_form(serial)))
    return any(known == form or known.endswith(f"_{form}") for form in forms)


def _udev_form(text: str) -> str:
    """Replace characters as udev does (systemd: udev_replace_chars in udev-util.c, and usb_id)."""
    return re.sub(r"[^#+\-.:=@\w]", "_", re.sub(r"\s+", "_", text.strip()))


def udev_serial(device: UsbAudioDevice) -> str:
    """Return a device's serial in udev's form; "" if there is none or udev omits it."""
    if any(not " " <= sign <= "~" or sign == "," for sign in device.serial):
        return ""
    return _udev_form(device.serial)


def coil_channels(vendor_id: str, product_id: str) -> tuple[int, ...]:
    """Return the numbers, from 0, of the channels that drive actuators; () if unknown."""
    return _COILS.get((vendor_id, product_id), ())
