"""The udev rule that lets whoever sits at the machine drive USB audio devices directly."""

from __future__ import annotations

import re

from device.errors import UsageError

PATH = "/etc/udev/rules.d/70-cushion.rules"
"""Before 73-seat-late.rules, which is what reads the tag."""

_USB_ID = re.compile(r"[0-9a-fA-F]{4}")


def udev_rule(vendor: str | None = None, product: str | None = None) -> str:
    """Return the rule, for all USB audio devices or for one: its ids as four hex digits each.

    Raises
    ------
    UsageError
        An id is something else, or only one of them is given.
    """
    match = 'ENV{ID_USB_INTERFACES}=="*:0101??:*"'  # audio class, its control interface
    what = "USB audio devices"
    if vendor is not None or product is not None:
        for text in (vendor, product):
            if text is None or not _USB_ID.fullmatch(text):
                raise UsageError(
                    f"a USB id is {text!r}; allowed: vendor and product, four hex digits each, "
                    "as lsusb shows them"
                )
        low, high = str(vendor).lower(), str(product).lower()  # as sysfs has them
        match = f'ATTR{{idVendor}}=="{low}", ATTR{{idProduct}}=="{high}"'
        what = f"the USB device {low}:{high}"
    return (
        f"# Haptic Cushion: whoever sits at the machine may drive {what} directly.\n"
        f'ACTION!="remove", SUBSYSTEM=="usb", ENV{{DEVTYPE}}=="usb_device", {match}, '
        'TAG+="uaccess"\n'
    )


def udev_command(rule: str) -> str:
    """Return the shell command that installs a rule as root, for the user to read and paste."""
    return (
        f"sudo tee {PATH} >/dev/null <<'END'\n{rule}END\n"
        "sudo udevadm control --reload && "
        "sudo udevadm trigger --subsystem-match=usb --action=change\n"
    )
