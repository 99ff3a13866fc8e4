"""Names of USB devices that stay the same after replugging, and the devices that they name.

A name is vendor, product and serial, and also the port if several units have the same serial, or
none. Card numbers and bus addresses change when a device is plugged in again. Pure functions.

A port is the kernel's name of it: the number of the bus, then a port of each hub. It stays the same
after a reboot as long as the machine keeps its USB controllers.
"""

from __future__ import annotations

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

_DUALSENSE = (2, 3)  # channels 0 and 1 are its speaker and headphones

_COILS = {
    ("054c", "0ce6"): _DUALSENSE,
    ("054c", "0df2"): _DUALSENSE,  # Edge
}


@dataclass(frozen=True)
class UsbIdentity:
    """The name of a USB device.

    vendor_id, product_id: four hexadecimal digits each, kept in lower case. serial, port: "" for
    any.

    UsageError: no device can have this name.
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
    def parse(cls, text: str) -> UsbIdentity:
        """Return the identity in a text, also without "usb:". UsageError: it has another form."""
        parts = _NAME.fullmatch(text.removeprefix("usb:"))
        if parts is None:
            raise UsageError(
                f"device {text!r} is not {GRAMMAR} with four hexadecimal digits each for VID and "
                "PID, and a port such as 1-2 or 1-2.3"
            )
        return cls(parts["vendor"], parts["product"], parts["serial"] or "", parts["port"] or "")

    def is_device(self, device: UsbAudioDevice) -> bool:
        """Return whether it names this device, perhaps among others."""
        if (self.vendor_id, self.product_id) != (device.vendor_id, device.product_id):
            return False
        if self.port not in ("", device.port):
            return False
        return self.serial == "" or self.serial in _serials(device)


def identify(device: UsbAudioDevice, present: Iterable[UsbAudioDevice]) -> UsbIdentity:
    """Return a name that no other device has, and that stays after replugging.

    device: with a unique serial its name is valid at every port, else it includes the port.
    present: all present devices, with or without this one.
    """
    bare = UsbIdentity(device.vendor_id, device.product_id)
    kind = attrgetter("vendor_id", "product_id", "serial")
    is_unique = all(other.port == device.port or kind(other) != kind(device) for other in present)
    if device.serial and is_unique:
        with suppress(UsageError):  # the serial ends like a port
            return replace(bare, serial=device.serial)
    return replace(bare, serial=device.serial, port=device.port)


def find_one(identity: UsbIdentity, found: Found) -> UsbAudioDevice:
    """Return the present device of a name.

    identity: the name. found: the present devices.

    NoUsbBusError, NoUsbDeviceError: no device has the name; the message lists the present ones.
    NotFoundError: several devices have it; the message gives a name for each.
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
    """Return whether a sound server's serial is a device's serial or was made from it."""
    forms = filter(None, (serial, _udev_form(serial)))
    return any(known == form or known.endswith(f"_{form}") for form in forms)


def _udev_form(text: str) -> str:
    """Return a device's string in udev's form, which sound servers use.

    Each run of blanks becomes one "_", and so does each character that udev does not allow
    (systemd, udev_replace_chars in udev-util.c, and usb_id).
    """
    joined = re.sub(r"\s+", "_", text.strip())
    return re.sub(r"[^#+\-.:=@\w]", "_", joined)


def udev_serial(device: UsbAudioDevice) -> str:
    """Return a device's serial in udev's form; "" if it has none or udev drops it.

    The serial of sound servers is this one behind the names of maker and product.
    """
    if any(not " " <= sign <= "~" or sign == "," for sign in device.serial):
        return ""
    return _udev_form(device.serial)


def _serials(device: UsbAudioDevice) -> tuple[str, ...]:
    """Return the forms of a device's serial: its own, udev's and a sound server's."""
    serial = udev_serial(device)
    vendor = _udev_form(device.manufacturer) or device.vendor_id
    model = _udev_form(device.product) or device.product_id
    return (device.serial, serial, f"{vendor}_{model}_{serial}") if serial else (device.serial,)


def coil_channels(vendor_id: str, product_id: str) -> tuple[int, ...]:
    """Return the channels with coils, counted from 0; () where all of them may have some.

    vendor_id, product_id: four hexadecimal digits each, in lower case.
    """
    return _COILS.get((vendor_id, product_id), ())
