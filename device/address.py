"""The device that a user names with the option `--device`, and the option's grammar."""

from dataclasses import dataclass
from typing import Literal, get_args

from device.alsa.cards import parse_card_address
from device.errors import NotFoundError, UsageError
from device.server.identity import find_sink
from device.server.snapshot import ServerSnapshot, Sink
from device.usb import mapping
from device.usb.identity import GRAMMAR as USB_GRAMMAR
from device.usb.identity import UsbIdentity

Kind = Literal["sink", "usb", "hw", "wav", "twin"]

KINDS: tuple[Kind, ...] = get_args(Kind)

GRAMMAR = f"sink:NAME, {USB_GRAMMAR}, hw:CARD[,DEVICE], wav:FILE, twin, or the name of a sink alone"


@dataclass(frozen=True)
class DeviceAddress:
    """One output device. kind: one of `KINDS`. name: as in "kind:name"; "" for `twin`."""

    kind: Kind
    name: str = ""

    def __str__(self) -> str:
        return f"{self.kind}:{self.name}" if self.name else self.kind

    @property
    def usb(self) -> UsbIdentity | None:
        """The USB ids, serial and port in the name; None unless `kind` is "usb"."""
        return UsbIdentity.parse(str(self)) if self.kind == "usb" else None

    def sink(self, snapshot: ServerSnapshot) -> Sink:
        """Return the sink of this device. NotFoundError: no sink matches, or several match."""
        if self.kind == "sink":
            return find_sink(snapshot, self.name)
        if (identity := self.usb) is None:
            raise NotFoundError(f"device {str(self)!r} is not on the sound server")
        found = [sink for sink in snapshot.sinks if mapping.is_sink_of(identity, sink)]
        if len(found) == 1:
            return found[0]
        if not found:
            raise NotFoundError(
                f"no sink of the sound server is the USB device {self.name}; plug it in, "
                "or see `cushion devices`"
            )
        names = ", ".join(
            repr(sink.name) + (f" in port {port}" if (port := mapping.port_of_sink(sink)) else "")
            for sink in found
        )
        raise NotFoundError(
            f"several USB devices match {self.name}: {names}; name one, as sink:NAME "
            "or with its port: append @PORT"
        )


def parse_device(text: str) -> DeviceAddress:
    """Return the device that a text names. A text without a colon, except `twin`, names a sink.

    UsageError: the kind is unknown, the name is missing or malformed, or `twin` has a name.
    """
    if text == "twin":
        return DeviceAddress("twin")
    before, colon, name = text.partition(":")
    kind, name = (before, name) if colon else ("sink", text)
    if kind == "usb" and name:
        UsbIdentity.parse(text)
    if kind == "hw" and name.strip():
        parse_card_address(name)
    for known in KINDS:
        if kind == known != "twin" and name.strip():
            return DeviceAddress(known, name)
    if kind == "twin":
        what = "has a name, but twin has none"
    elif kind in KINDS:
        what = "has an empty name"
    else:
        what = f"has the unknown kind {kind!r} (for a sink of that name write sink:{text})"
    raise UsageError(f"device {text!r} {what}; allowed: {GRAMMAR}")
