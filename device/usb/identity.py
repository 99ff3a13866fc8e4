"""Which USB device is meant: names that last beyond unplugging, and what a name leads to.

A name is vendor, product and serial; makers who give every unit the same serial, or none, leave
only the port to tell two of a kind apart. The number of a sound card and the address on the bus
are no part of it: both change from one plugging in to the next. Pure functions.

A port is named as the kernel does: the number of the bus, then a port of each hub. It stays over a
reboot as long as the machine keeps its USB controllers.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from device.errors import NotFoundError, UsageError
from device.usb.errors import NoUsbDeviceError
from device.usb.sysfs import Found, UsbAudioDevice

GRAMMAR = "usb:VID:PID[:SERIAL][@PORT]"

_NAME = re.compile(
    r"(?P<vendor>[0-9a-fA-F]{4}):(?P<product>[0-9a-fA-F]{4})"
    r"(?::(?P<serial>.+?))?(?:@(?P<port>\d+-\d+(?:\.\d+)*))?"
)


@dataclass(frozen=True)
class UsbIdentity:
    """A USB device by name. serial, port: "" for any.

    vendor_id, product_id: four hexadecimal digits each, kept in lower case.

    Raises
    ------
    UsageError
        No device can be named like this.
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
        """Return what `str` wrote, or a user, "usb:" being optional.

        Raises
        ------
        UsageError
            It is not written as `GRAMMAR` says.
        """
        parts = _NAME.fullmatch(text.removeprefix("usb:"))
        if parts is None:
            raise UsageError(
                f"{text!r} names no USB device: it is written {GRAMMAR}, with four hexadecimal "
                "digits for VID and PID each and a port such as 1-2 or 1-2.3"
            )
        return cls(parts["vendor"], parts["product"], parts["serial"] or "", parts["port"] or "")

    def is_device(self, device: UsbAudioDevice) -> bool:
        """Whether it names this device, perhaps among others."""
        if (self.vendor_id, self.product_id) != (device.vendor_id, device.product_id):
            return False
        if self.port not in ("", device.port):
            return False
        return not self.serial or (
            device.serial != "" and self.serial in (device.serial, *_server_serials(device))
        )


def identify(device: UsbAudioDevice, present: Iterable[UsbAudioDevice]) -> UsbIdentity:
    """Return the name to keep of a device: it leads to no other one, now or after plugging.

    present: all that are there, with this device or without. With a serial of its own a device
    keeps its name in every port; else the port is a part of it.
    """
    bare = UsbIdentity(device.vendor_id, device.product_id)
    twins = any(other.port != device.port and _same_kind(other, device) for other in present)
    if device.serial and not twins:
        try:
            return replace(bare, serial=device.serial)
        except UsageError:  # it ends as if a port followed
            pass
    return replace(bare, serial=device.serial, port=device.port)


def matching(
    identity: UsbIdentity, devices: Iterable[UsbAudioDevice]
) -> tuple[UsbAudioDevice, ...]:
    """Return the devices that a name leads to."""
    return tuple(device for device in devices if identity.is_device(device))


def find_one(identity: UsbIdentity, found: Found) -> UsbAudioDevice:
    """Return the device that a name leads to.

    Raises
    ------
    NoUsbBusError, NoUsbDeviceError
        There is none. The message lists those that are there.
    NotFoundError
        There are several; nothing is chosen among them. The message says how to name one.
    """
    matches = matching(identity, found.devices)
    if len(matches) == 1:
        return matches[0]
    if matches:
        raise NotFoundError(
            f"{identity} is not one device but {len(matches)}: "
            f"{describe(matches, found.devices)}; name one as written here"
        )
    if not found.devices and found.reason is not None:
        raise type(found.reason)(f"{identity} is not there: {found.reason}")
    raise NoUsbDeviceError(
        f"{identity} is not there: plug it in, or name one of "
        f"{describe(found.devices, found.devices)}"
    )


def find_again(
    gone: UsbAudioDevice, before: Sequence[UsbAudioDevice], now: Iterable[UsbAudioDevice]
) -> UsbAudioDevice | None:
    """Return the device that was pulled out, now that it is back; None while that is not sure.

    before: those that were there with it. In the same port it is itself. In another one it is,
    where it was the only one of its kind and serial, and there is only one now: of two alike
    nobody can tell which came back.
    """
    alike = [device for device in now if _same_kind(device, gone)]
    for device in alike:
        if device.port == gone.port:
            return device
    had_twin = any(other.port != gone.port and _same_kind(other, gone) for other in before)
    return alike[0] if len(alike) == 1 and not had_twin else None


def describe(devices: Iterable[UsbAudioDevice], present: Iterable[UsbAudioDevice]) -> str:
    """Return devices on one line, each with the name that leads to it alone."""
    known = tuple(present)
    return ", ".join(
        f"{identify(device, known)} ({device.label}, port {device.port}"
        + "".join(f", card {card.number}" for card in device.cards)
        + ")"
        for device in devices
    )


def is_server_serial(known: str, serial: str) -> bool:
    """Whether what a sound server calls a serial is that of a device, or was copied from there."""
    return any(
        known == form or known.endswith(f"_{form}") for form in (serial, udev_form(serial)) if form
    )


def udev_form(text: str) -> str:
    """Return a string of a device as udev has it, and sound servers from there.

    Blanks are joined into one "_"; so is whatever is none of its signs (systemd, udev_replace_chars
    in udev-util.c, and usb_id).
    """
    joined = re.sub(r"\s+", "_", text.strip())
    return re.sub(r"[^#+\-.:=@\w]", "_", joined)


def udev_serial(device: UsbAudioDevice) -> str:
    """Return the serial of a device as udev has it; "" where it has none or udev drops it.

    What sound servers call the serial is this one behind the names of maker and product.
    """
    if any(not " " <= sign <= "~" or sign == "," for sign in device.serial):
        return ""
    return udev_form(device.serial)


def _server_serials(device: UsbAudioDevice) -> tuple[str, ...]:
    """Return what else a serial may have been copied from: udev's own form, a sound server's."""
    serial = udev_serial(device)
    vendor = udev_form(device.manufacturer) or device.vendor_id
    model = udev_form(device.product) or device.product_id
    return (serial, f"{vendor}_{model}_{serial}") if serial else ()


def _same_kind(one: UsbAudioDevice, other: UsbAudioDevice) -> bool:
    return (one.vendor_id, one.product_id, one.serial) == (
        other.vendor_id,
        other.product_id,
        other.serial,
    )
