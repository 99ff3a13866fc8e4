"""Which ALSA names and sinks of a sound server belong to which USB device. Pure functions.

The first of these properties that a sink has determines its device: path in /sys, sound card, ids.
No device matches if other properties contradict card or ids, or if several devices have the ids.
"""

import re
from collections.abc import Iterable

from device.server.identity import identity_of
from device.server.snapshot import Sink
from device.usb.identity import UsbIdentity, is_server_serial, udev_serial
from device.usb.sysfs import UsbAudioDevice

_CARD_KEYS = ("alsa.card", "api.alsa.pcm.card", "api.alsa.card")

_PORT_FOLDER = re.compile(r"/(\d+-\d+(?:\.\d+)*)(?=/|$)")
_BUS_PATH = re.compile(r"-usb(?:v\d)?-\d+:(?P<chain>[\d.]+):")
_IN_BRACKETS = re.compile(r"\((?:plug)?hw:(?P<card>[^,()]+)(?:,\d+)?\)$")
_PCM_NAME = re.compile(r"[a-z]\w*:(?:CARD=)?(?P<card>[^,:\s]+)(?:,.*)?")


def hw_names(device: UsbAudioDevice) -> tuple[str, ...]:
    """Return the ALSA names of a device's playback devices, such as "hw:1,0"."""
    return tuple(f"hw:{card.number},{pcm}" for card in device.cards for pcm in card.playback)


def card_of_name(name: str) -> str:
    """Return the number or id of the card in an ALSA or PortAudio name; "" if there is none.

    It is "1" for "hw:1,0" and "DAC: USB Audio (hw:1,0)", "DAC" for "plughw:CARD=DAC,DEV=0".
    """
    match = _IN_BRACKETS.search(name) or _PCM_NAME.fullmatch(name)
    return match["card"] if match else ""


def device_of_card(card: int | str, devices: Iterable[UsbAudioDevice]) -> UsbAudioDevice | None:
    """Return the USB device that has a sound card, None if none has. card: its number or id."""
    for device in devices:
        # an ALSA id is never a number; "" means an unknown id
        if any(str(card) in (str(each.number), each.id or None) for each in device.cards):
            return device
    return None


def device_of_sink(sink: Sink, devices: Iterable[UsbAudioDevice]) -> UsbAudioDevice | None:
    """Return the device on which a sink plays; None if the device is unknown or ambiguous."""
    known = tuple(devices)
    if place := sink.properties.get("sysfs.path", ""):
        folder = f"{place.removeprefix('/sys')}/"
        above = [device for device in known if folder.startswith(f"{device.path}/")]
        return max(above, key=lambda device: len(device.path), default=None)
    properties = sink.properties
    numbers = [properties.get(key, "") for key in _CARD_KEYS]
    names = [card_of_name(properties.get(key, "")) for key in ("api.alsa.path", "device.string")]
    if card := next(filter(None, numbers + names), ""):
        device = device_of_card(card, known)
        return device if device is not None and _agrees(sink, device) else None
    identity = identity_of(sink)
    if identity.bus != "usb" or not identity.vendor_id:
        return None
    alike = [device for device in known if _agrees(sink, device)]
    return alike[0] if len(alike) == 1 else None


def is_sink_of(identity: UsbIdentity, sink: Sink) -> bool:
    """Whether a sink plays on a device that `identity` names."""
    known = identity_of(sink)
    if not known.is_usb(identity.vendor_id, identity.product_id):
        return False
    if identity.serial and not is_server_serial(known.serial, identity.serial):
        return False
    if port := port_of_sink(sink):
        return identity.port in ("", port)
    return not identity.port or _chain_of(sink) == identity.port.partition("-")[2]


def port_of_sink(sink: Sink) -> str:
    """Return the USB port of a sink's device, such as "1-2.3"; "" if unknown."""
    ports = _PORT_FOLDER.findall(sink.properties.get("sysfs.path", ""))
    return str(ports[-1]) if ports else ""


def _agrees(sink: Sink, device: UsbAudioDevice) -> bool:
    """Whether all that is known of a sink's bus, ids, port and serial agrees with a device."""
    known = identity_of(sink)
    if known.bus not in ("", "usb"):
        return False
    ids = (known.vendor_id, known.product_id)
    if known.vendor_id and ids != (device.vendor_id, device.product_id):
        return False
    if (chain := _chain_of(sink)) and chain != device.port.partition("-")[2]:
        return False
    return (
        not known.serial or not udev_serial(device) or is_server_serial(known.serial, device.serial)
    )


def _chain_of(sink: Sink) -> str:
    """Return the hub ports in a bus path: "2.3" in "pci-0000:00:14.0-usb-0:2.3:1.0"."""
    match = _BUS_PATH.search(sink.properties.get("device.bus_path", ""))
    return match["chain"] if match else ""
