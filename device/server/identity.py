"""Who is who on a sound server: sinks by exact name, monitors, our own streams, real devices.

Pure functions on a snapshot; any thread may call them. Nothing is ever substituted: a name that
does not match exactly is an error, which offers the nearest ones.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterable
from dataclasses import dataclass

from device.errors import NotFoundError, UsageError
from device.server.snapshot import ServerSnapshot, Sink, Source, Stream
from device.stream.pcms import FALLBACK_SINK, TAG
from device.suggest import no_such


def find_sink(snapshot: ServerSnapshot, name: str) -> Sink:
    """The sink with exactly this name.

    Raises
    ------
    NotFoundError
        There is none; the nearest names are offered.
    """
    for sink in snapshot.sinks:
        if sink.name == name:
            return sink
    names = (sink.name for sink in snapshot.sinks if sink.name != FALLBACK_SINK)
    raise NotFoundError(_no_such("sink", name, names))


def monitor_of(snapshot: ServerSnapshot, sink_name: str) -> Source:
    """The monitor of the sink with exactly this name: what a tap on that sink records from.

    Raises
    ------
    NotFoundError
        There is no such sink, or it has no monitor.
    """
    sink = find_sink(snapshot, sink_name)
    for source in snapshot.sources:
        if source.monitor_of == sink.name:
            return source
    raise NotFoundError(f"the sink {sink_name!r} has no monitor; tap another sink")


def find_monitor(snapshot: ServerSnapshot, source_name: str) -> Source:
    """The source with exactly this name, which is a sink's monitor: never a microphone.

    Raises
    ------
    NotFoundError
        There is no such source; the nearest monitors are offered.
    UsageError
        It is no monitor.
    """
    for source in snapshot.sources:
        if source.name == source_name:
            if source.monitor_of is None:
                raise UsageError(
                    f"the source {source_name!r} is no monitor of a sink but a microphone or an "
                    "input, which is never tapped; name a sink, as in sink:NAME"
                )
            return source
    monitors = (source.name for source in snapshot.sources if source.monitor_of is not None)
    raise NotFoundError(_no_such("monitor", source_name, monitors))


def find_source(snapshot: ServerSnapshot, name: str) -> Source:
    """The source with exactly this name, be it a monitor or an input: for measuring alone.

    Raises
    ------
    NotFoundError
        There is none; the nearest names are offered. Nothing is ever taken instead.
    """
    for source in snapshot.sources:
        if source.name == name:
            return source
    raise NotFoundError(_no_such("source", name, (source.name for source in snapshot.sources)))


def default_monitor(snapshot: ServerSnapshot, haptic_sink: str | None = None) -> Source:
    """The monitor of the default sink: what a tap on "everything that is heard" records from.

    haptic_sink: where the vibration goes; it is never tapped, since that would feed back.

    Raises
    ------
    NotFoundError
        There is no default sink, or the vibration goes there.
    """
    name = snapshot.default_sink
    if not name:
        raise NotFoundError(
            "the sound server has no default sink; choose one in the sound settings or with "
            "`pactl set-default-sink NAME`, or name the sink to tap"
        )
    if name == haptic_sink:
        raise NotFoundError(
            f"the default sink {name!r} is the one that the vibration goes to, and a tap there "
            "would feed back; choose another default sink, or name the sink to tap"
        )
    return monitor_of(snapshot, name)


def is_own_stream(stream: Stream, process_id: int | None = None) -> bool:
    """Whether a stream is of this process (or the given one), on this machine."""
    host = stream.properties.get("application.process.host", "")
    if host not in ("", socket.gethostname()):
        return False
    return stream.process_id == (os.getpid() if process_id is None else process_id)


def is_cushion_stream(stream: Stream) -> bool:
    """Whether a stream is one of a daemon like this one, in whatever process."""
    return TAG in stream.properties


def find_tagged(streams: Iterable[Stream], tag: str) -> Stream | None:
    """Our own stream that was opened with this tag, None if it is not (or no longer) there."""
    for stream in streams:
        if stream.properties.get(TAG) == tag:
            return stream
    return None


@dataclass(frozen=True)
class DeviceIdentity:
    """What stays the same about a device from one plugging in to the next; "" where unknown.

    vendor_id, product_id: four hexadecimal digits, of a USB device. serial: as servers have it,
    which is udev's VENDOR_MODEL_SERIAL rather than the device's own. bus_path: the socket that it
    is plugged into. alsa_card: ALSA's number, which is not stable, but leads to /proc/asound.
    """

    bus: str
    vendor_id: str
    product_id: str
    serial: str
    bus_path: str
    alsa_card: str

    def is_usb(self, vendor_id: str, product_id: str, serial: str = "") -> bool:
        """Whether this is that USB device: ids in hexadecimal, the device's own serial or ""."""
        if self.bus != "usb" or not self.vendor_id:
            return False
        if (self.vendor_id, self.product_id) != (_usb_id(vendor_id), _usb_id(product_id)):
            return False
        return not serial or self.serial == serial or self.serial.endswith(f"_{serial}")


def identity_of(sink: Sink) -> DeviceIdentity:
    """The identity of the device behind a sink; all "" for one that is made of software."""
    known = sink.properties
    return DeviceIdentity(
        bus=known.get("device.bus", ""),
        vendor_id=_usb_id(known.get("device.vendor.id", "")),
        product_id=_usb_id(known.get("device.product.id", "")),
        serial=known.get("device.serial", ""),
        bus_path=known.get("device.bus_path", ""),
        alsa_card=known.get("alsa.card", known.get("api.alsa.pcm.card", "")),
    )


def _usb_id(text: str) -> str:
    """Four hexadecimal digits from "046d" (PulseAudio) or "0x046d" (PipeWire)."""
    digits = text.lower().removeprefix("0x")
    try:
        return f"{int(digits, 16):04x}"
    except ValueError:
        return ""


def _no_such(kind: str, name: str, names: Iterable[str]) -> str:
    return no_such(kind, name, names, "connect a sound card, or start the sound server anew")
