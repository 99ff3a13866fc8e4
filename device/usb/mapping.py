"""From a USB device to its ALSA names and a sound server's sinks, and back. Pure functions.

The most reliable property of a sink counts: its path in /sys, then the number of its sound card if
the ids agree, then ids and serial if they are unique. A sink of an unplugged device never leads to
another device.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from device.server.identity import identity_of
from device.server.snapshot import Sink
from device.usb.identity import UsbIdentity, is_server_serial, udev_serial
from device.usb.sysfs import UsbAudioDevice

_CARD_KEYS = ("alsa.card", "api.alsa.pcm.card", "api.alsa.card")
_PCM_KEYS = ("api.alsa.path", "device.string")

_PORT_FOLDER = re.compile(r"/(\d+-\d+(?:\.\d+)*)(?=/|$)")
_BUS_PATH = re.compile(r"-usb(?:v\d)?-\d+:(?P<chain>[\d.]+):")
_IN_BRACKETS = re.compile(r"\((?:plug)?hw:(?P<card>[^,()]+)(?:,\d+)?\)$")
_PCM_NAME = re.compile(r"[a-z]\w*:(?:CARD=)?(?P<card>[^,:\s]+)(?:,.*)?")


def hw_names(device: UsbAudioDevice) -> tuple[str, ...]:
    """Return the ALSA names of a device's playback devices, such as "hw:1,0"."""
    return tuple(f"hw:{card.number},{pcm}" for card in device.cards for pcm in card.playback)


def card_of_name(name: str) -> str:
    """Return the number or id of the card in an ALSA or PortAudio name; "" if it has none.

    It is 1 in "hw:1,0" and "DAC: USB Audio (hw:1,0)", and "DAC" in "plughw:CARD=DAC,DEV=0".
    """
    match = _IN_BRACKETS.search(name) or _PCM_NAME.fullmatch(name)
    return match["card"] if match else ""


def device_of_card(card: int | str, devices: Iterable[UsbAudioDevice]) -> UsbAudioDevice | None:
    """Return the device of a sound card, by its number or id."""
    for device in devices:
        # ALSA allows no id that is a number; an id is "" if it is unknown
        if any(str(card) in (str(each.number), each.id or None) for each in device.cards):
            return device
    return None


def device_of_sink(sink: Sink, devices: Iterable[UsbAudioDevice]) -> UsbAudioDevice | None:
    """Return the device that a sink plays on, or None if that is unknown."""
    known = tuple(devices)
    place = sink.properties.get("sysfs.path", "")
    if place:
        folder = f"{place.removeprefix('/sys')}/"
        above = [device for device in known if folder.startswith(f"{device.path}/")]
        return max(above, key=lambda device: len(device.path), default=None)
    card = _card_of(sink.properties)
    if card:
        device = device_of_card(card, known)
        return device if device is not None and _agrees(sink, device) else None
    identity = identity_of(sink)
    if identity.bus != "usb" or not identity.vendor_id:
        return None
    alike = [device for device in known if _agrees(sink, device)]
    return alike[0] if len(alike) == 1 else None


def sinks_of(
    device: UsbAudioDevice, sinks: Iterable[Sink], devices: Iterable[UsbAudioDevice]
) -> tuple[Sink, ...]:
    """Return the sinks that play on a device. devices: all present devices, also this one."""
    known = tuple(devices)
    return tuple(sink for sink in sinks if device_of_sink(sink, known) == device)


def is_sink_of(identity: UsbIdentity, sink: Sink) -> bool:
    """Return whether a sink plays on a device of this name, by the sink's properties alone.

    A name with a port needs a sink that reports its port.
    """
    known = identity_of(sink)
    if not known.is_usb(identity.vendor_id, identity.product_id):
        return False
    if identity.serial and not is_server_serial(known.serial, identity.serial):
        return False
    if not identity.port:
        return True
    port = port_of_sink(sink)
    if port:
        return port == identity.port
    return _chain_of(sink) == identity.port.partition("-")[2]


def port_of_sink(sink: Sink) -> str:
    """Return the port that a sink's device is plugged into, such as "1-2.3"; "" if unknown."""
    ports = _PORT_FOLDER.findall(sink.properties.get("sysfs.path", ""))
    return str(ports[-1]) if ports else ""


def _card_of(properties: Mapping[str, str]) -> str:
    for key in _CARD_KEYS:
        if properties.get(key):
            return properties[key]
    return next(filter(None, (card_of_name(properties.get(key, "")) for key in _PCM_KEYS)), "")


def _agrees(sink: Sink, device: UsbAudioDevice) -> bool:
    """Return whether no property of a sink contradicts a device."""
    known = identity_of(sink)
    if known.bus not in ("", "usb"):
        return False
    ids = (known.vendor_id, known.product_id)
    if known.vendor_id and ids != (device.vendor_id, device.product_id):
        return False
    chain = _chain_of(sink)
    if chain and chain != device.port.partition("-")[2]:
        return False
    return (
        not known.serial or not udev_serial(device) or is_server_serial(known.serial, device.serial)
    )


def _chain_of(sink: Sink) -> str:
    """Return the ports of a bus path such as "pci-0000:00:14.0-usb-0:2.3:1.0": "2.3"."""
    match = _BUS_PATH.search(sink.properties.get("device.bus_path", ""))
    return match["chain"] if match else ""
