"""Where the vibration shall go, as a user writes it: the grammar of `--device`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, get_args

from device.errors import NotFoundError, UsageError
from device.server.identity import find_sink, identity_of
from device.server.snapshot import ServerSnapshot, Sink

Kind = Literal["sink", "usb", "hw", "wav", "twin"]

KINDS: tuple[Kind, ...] = get_args(Kind)

GRAMMAR = "sink:NAME, usb:VID:PID[:SERIAL], hw:CARD, wav:FILE, twin, or the name of a sink alone"

_USB = re.compile(r"(?P<vendor>[0-9a-fA-F]{4}):(?P<product>[0-9a-fA-F]{4})(?::(?P<serial>.+))?")


@dataclass(frozen=True)
class DeviceAddress:
    """One device: its kind and its name, ids or file (empty for `twin`)."""

    kind: Kind
    name: str = ""

    def __str__(self) -> str:
        return f"{self.kind}:{self.name}" if self.name else self.kind

    def sink(self, snapshot: ServerSnapshot) -> Sink:
        """Return the sound server's sink of this device.

        Raises
        ------
        NotFoundError
            It is not there, or two are: nothing is ever substituted.
        """
        if self.kind == "sink":
            return find_sink(snapshot, self.name)
        usb = _USB.fullmatch(self.name)
        if self.kind != "usb" or usb is None:
            raise NotFoundError(f"device {str(self)!r} is none of the sound server's")
        vendor, product, serial = usb["vendor"], usb["product"], usb["serial"] or ""
        found = [
            sink for sink in snapshot.sinks if identity_of(sink).is_usb(vendor, product, serial)
        ]
        if len(found) == 1:
            return found[0]
        if not found:
            raise NotFoundError(
                f"no sink of the sound server is the USB device {self.name}; plug it in, "
                "or see `cushion devices`"
            )
        names = ", ".join(repr(sink.name) for sink in found)
        raise NotFoundError(f"the USB device {self.name} is not one but several: {names}; name one")


def parse_device(text: str) -> DeviceAddress:
    """What the text stands for. A word without a colon is the name of a sink.

    The name is taken as it is written: nothing is trimmed, completed or looked up.

    Raises
    ------
    UsageError
        The kind is none of `KINDS`, a name is missing, or `twin` has one.
    """
    if text == "twin":
        return DeviceAddress("twin")
    before, colon, name = text.partition(":")
    kind, name = (before, name) if colon else ("sink", text)
    if kind == "usb" and name and not _USB.fullmatch(name):
        raise UsageError(
            f"device {text!r}: a USB device is written usb:VID:PID or usb:VID:PID:SERIAL, "
            "with four hexadecimal digits each"
        )
    for known in KINDS:
        if kind == known != "twin" and name.strip():
            return DeviceAddress(known, name)
    if kind == "twin":
        what = "'twin' takes no name"
    elif kind in KINDS:
        what = "the name is empty"
    else:
        what = f"there is no kind {kind!r} (a sink of that name is written sink:{text})"
    raise UsageError(f"device {text!r}: {what}; allowed: {GRAMMAR}")
