"""Finds sinks and sources by exact name, this program's streams, and a device's identity."""

import os
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

from device.errors import NotFoundError
from device.server.snapshot import ServerSnapshot, Sink, Source, Stream
from device.stream.pcms import APPLICATION_ID, FALLBACK_SINK, ROLE, TAG
from device.values import no_such

Device = TypeVar("Device", Sink, Source)


def find_sink(snapshot: ServerSnapshot, name: str) -> Sink:
    """Return the sink with exactly this name. NotFoundError: no such sink; others are listed."""
    return _find("sink", name, snapshot.sinks)


def find_source(snapshot: ServerSnapshot, name: str) -> Source:
    """Return the source with exactly this name. NotFoundError: see `find_sink`."""
    return _find("source", name, snapshot.sources)


def monitor_of(snapshot: ServerSnapshot, sink_name: str) -> Source:
    """Return the monitor of a sink. NotFoundError: the sink or its monitor is missing."""
    find_sink(snapshot, sink_name)
    for source in snapshot.sources:
        if source.monitor_of == sink_name:
            return source
    raise NotFoundError(f"the sink {sink_name!r} has no monitor; tap another sink")


def default_monitor(snapshot: ServerSnapshot, haptic_sink: str | None = None) -> Source:
    """Return the default sink's monitor.

    NotFoundError: there is no default sink, it has no monitor, or it plays the vibration.
    """
    if not (name := snapshot.default_sink):
        raise NotFoundError(
            "the sound server has no default sink; choose one in the sound settings or with "
            "`pactl set-default-sink NAME`, or name the sink to tap"
        )
    if name == haptic_sink:
        raise NotFoundError(
            f"the vibration goes to the default sink {name!r}, and a tap there would feed back; "
            "choose another default sink, or name the sink to tap"
        )
    return monitor_of(snapshot, name)


def is_own_stream(stream: Stream) -> bool:
    """Whether a stream belongs to this process on this machine."""
    host = stream.properties.get("application.process.host", "")
    return host in ("", socket.gethostname()) and stream.process_id == os.getpid()


def is_ours(stream: Stream) -> bool:
    """Whether a stream belongs to this process, or to any process of this program."""
    return (
        stream.role == ROLE
        or stream.properties.get("application.id") == APPLICATION_ID
        or is_cushion_stream(stream)
        or is_own_stream(stream)
    )


def is_cushion_stream(stream: Stream) -> bool:
    """Whether a process of this program opened the stream."""
    return TAG in stream.properties


def find_tagged(streams: Iterable[Stream], tag: str) -> Stream | None:
    """Return the stream whose property `TAG` has this value, or None."""
    return next((stream for stream in streams if stream.properties.get(TAG) == tag), None)


@dataclass(frozen=True)
class DeviceIdentity:
    """The properties that identify a sink's device; "" if unknown.

    vendor_id, product_id: four hexadecimal digits each. serial: udev's VENDOR_MODEL_SERIAL.
    alsa_card: the card's number in ALSA, which may change.
    """

    bus: str
    vendor_id: str
    product_id: str
    serial: str
    alsa_card: str

    def is_usb(self, vendor_id: str, product_id: str) -> bool:
        """Whether the device is a USB device with these hexadecimal ids."""
        wanted = ("usb", _usb_id(vendor_id), _usb_id(product_id))
        return bool(self.vendor_id) and (self.bus, self.vendor_id, self.product_id) == wanted


def identity_of(sink: Sink) -> DeviceIdentity:
    """Return the identity of a sink's device; all "" for a virtual sink."""
    known = sink.properties
    return DeviceIdentity(
        bus=known.get("device.bus", ""),
        vendor_id=_usb_id(known.get("device.vendor.id", "")),
        product_id=_usb_id(known.get("device.product.id", "")),
        serial=known.get("device.serial", ""),
        alsa_card=known.get("alsa.card", known.get("api.alsa.pcm.card", "")),
    )


def _usb_id(text: str) -> str:
    """Return four hexadecimal digits from "046d" (PulseAudio) or "0x046d" (PipeWire)."""
    digits = text.lower().removeprefix("0x")
    try:
        return f"{int(digits, 16):04x}"
    except ValueError:
        return ""


def _find(kind: str, name: str, devices: tuple[Device, ...]) -> Device:
    for device in devices:
        if device.name == name:
            return device
    names = [device.name for device in devices if device.name != FALLBACK_SINK]
    advice = "connect a sound card, or restart the sound server"
    raise NotFoundError(no_such(kind, name, names, advice))
