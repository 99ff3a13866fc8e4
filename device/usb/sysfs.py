"""USB audio devices as the kernel lists them; this needs no permission and opens no device.

All information is from /sys and /proc; only tests pass another `root`. A device that is unplugged
while it is read is left out. Audio threads must not call these functions: reading files may block.
"""

import os
import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from device.errors import NotFoundError, NoUsbBusError, NoUsbDeviceError
from device.usb.descriptors import DescriptorError, parse_whole, playback_formats

ROOT = Path("/")

_AUDIO_CLASS, _STREAMING = 0x01, 0x02

_PORT = re.compile(r"(\d+)-\d+(\.\d+)*")
_INTERFACE = re.compile(r"(?P<port>\d+-[\d.]+):\d+\.\d+")
_CARD = re.compile(r"card(\d+)")
_PCM = re.compile(r"pcmC(?P<card>\d+)D(?P<device>\d+)p")


@dataclass(frozen=True)
class AudioInterface:
    """One audio interface of a device."""

    number: int
    subclass: int  # 1 control, 2 streaming, 3 MIDI
    driver: str  # the attached driver, such as "snd-usb-audio", "" for none


@dataclass(frozen=True)
class AlsaCard:
    """A sound card. id: ALSA's id, "" if unknown. playback: numbers of its playback devices."""

    number: int
    id: str
    playback: tuple[int, ...]


@dataclass(frozen=True)
class UsbAudioDevice:
    """One USB device with an audio interface, as it was when it was read.

    port: bus number and port on each hub, such as "1-2.3". path: below /sys, such as
    "/devices/pci0000:00/0000:00:14.0/usb1/1-2". vendor_id, product_id: four hexadecimal digits
    each. manufacturer, product, serial: texts from the device, "" for none; "�" replaces
    unprintable characters. bus, address: numbers that the kernel gave; plugging the device in again
    changes the address. speed: Mbit/s, 0 if unknown. max_power_ma: None if unknown. configuration:
    number of the active configuration, None if unknown or none. descriptors: bytes of the device
    descriptor and the configurations; b"" if unreadable. node: path of the device file.
    interfaces, cards: the device's audio interfaces and sound cards.
    """

    port: str
    path: str
    vendor_id: str
    product_id: str
    manufacturer: str
    product: str
    serial: str
    bus: int
    address: int
    speed: float
    max_power_ma: int | None
    configuration: int | None
    descriptors: bytes
    node: Path
    interfaces: tuple[AudioInterface, ...]
    cards: tuple[AlsaCard, ...]

    @property
    def plays(self) -> bool:
        """Whether the device can play sound, according to its cards, descriptors or interfaces."""
        if any(card.playback for card in self.cards):
            return True
        try:
            configuration = parse_whole(self.descriptors).active(self.configuration)
        except DescriptorError:
            configuration = None
        if configuration is not None:
            return bool(playback_formats(configuration))
        return not self.cards and any(each.subclass == _STREAMING for each in self.interfaces)

    @property
    def label(self) -> str:
        """Manufacturer and product for display; vendor and product id if both are unknown."""
        return " ".join(filter(None, (self.manufacturer, self.product))) or (
            f"{self.vendor_id}:{self.product_id}"
        )


@dataclass(frozen=True)
class Found:
    """The present devices. devices: sorted by port. reason: why none can play, or None."""

    devices: tuple[UsbAudioDevice, ...]
    reason: NotFoundError | None = None


def find_devices(root: Path = ROOT) -> Found:
    """Return every readable USB device with an audio interface. root: folder with sys and proc."""
    bus = root / "sys/bus/usb/devices"
    names = _names_in(bus)
    if not any(name.startswith("usb") for name in names) and not (root / "dev/bus/usb").is_dir():
        reason = NoUsbBusError(
            "no USB bus is visible in /sys/bus/usb or /dev/bus/usb; pass both on to a container "
            "(--device /dev/bus/usb), or add a USB controller to a virtual machine"
        )
        return Found((), reason)
    cards = _cards(root)
    interfaces = defaultdict(list)
    for name in names:
        if match := _INTERFACE.fullmatch(name):
            interfaces[match["port"]].append(bus / name)
    # sorted by numbers: 1-10 follows 1-2
    ports = sorted(filter(_PORT.fullmatch, names), key=lambda p: [*map(int, re.split("[-.]", p))])
    found = (_device(root, port, sorted(interfaces[port]), cards) for port in ports)
    devices = tuple(filter(None, found))
    return Found(devices, _why_none_plays(devices))


def _names_in(folder: Path) -> frozenset[str]:
    try:
        return frozenset(os.listdir(folder))  # noqa: PTH208 - faster than Path.iterdir
    except OSError:
        return frozenset()


def _why_none_plays(devices: tuple[UsbAudioDevice, ...]) -> NoUsbDeviceError | None:
    if any(device.plays for device in devices):
        return None
    if others := [f"{device.label!r} in port {device.port}" for device in devices]:
        return NoUsbDeviceError(
            f"no USB device plays sound: {', '.join(others)} is only for MIDI or recording; plug "
            "in the DAC"
        )
    return NoUsbDeviceError(
        "no USB audio device is plugged in; plug in the DAC, with its own power if it has any, and "
        "see whether `lsusb` shows it"
    )


def _device(
    root: Path, port: str, interfaces: Iterable[Path], cards: dict[str, list[AlsaCard]]
) -> UsbAudioDevice | None:
    """Read one device; return None if it has no audio interface or is being unplugged."""
    folder = root / "sys/bus/usb/devices" / port
    if not (audio := tuple(filter(None, map(_interface, interfaces)))):
        return None
    try:
        before = (folder / "devnum").read_bytes()
        real = os.path.realpath(folder)
        bus, address = int((folder / "busnum").read_bytes()), int(before)
        value = _number(folder / "bConfigurationValue", r"\d+")
        device = UsbAudioDevice(
            port=port,
            path=real.removeprefix(os.path.realpath(root / "sys")),
            vendor_id=f"{int((folder / 'idVendor').read_bytes(), 16):04x}",
            product_id=f"{int((folder / 'idProduct').read_bytes(), 16):04x}",
            manufacturer=_text(folder / "manufacturer"),
            product=_text(folder / "product"),
            serial=_text(folder / "serial"),
            bus=bus,
            address=address,
            speed=float(_number(folder / "speed", r"\d+(\.\d+)?") or 0),
            max_power_ma=int(power) if (power := _number(folder / "bMaxPower", r"\d+")) else None,
            configuration=int(value) if value else None,
            descriptors=_bytes(folder / "descriptors"),
            node=root / f"dev/bus/usb/{bus:03d}/{address:03d}",
            interfaces=audio,
            cards=tuple(cards.get(real, ())),
        )
        # If another device has replaced this one meanwhile, the values may be of both devices.
        if (folder / "devnum").read_bytes() != before:
            return None
    except (OSError, ValueError):
        return None
    return device


def _interface(folder: Path) -> AudioInterface | None:
    driver = folder / "driver"
    try:
        if int((folder / "bInterfaceClass").read_bytes(), 16) != _AUDIO_CLASS:
            return None
        return AudioInterface(
            number=int((folder / "bInterfaceNumber").read_bytes(), 16),
            subclass=int((folder / "bInterfaceSubClass").read_bytes(), 16),
            driver=driver.readlink().name if driver.is_symlink() else "",
        )
    except (OSError, ValueError):
        return None


def _cards(root: Path) -> dict[str, list[AlsaCard]]:
    """Return the sound cards of each USB device, keyed by the real path of the device."""
    sound = root / "sys/class/sound"
    names = _names_in(sound)
    playback = defaultdict(list)
    for name in names:
        if match := _PCM.fullmatch(name):
            playback[int(match["card"])].append(int(match["device"]))
    cards = defaultdict(list)
    for number in sorted(int(match[1]) for name in names if (match := _CARD.fullmatch(name))):
        place = Path(os.path.realpath(sound / f"card{number}" / "device"))
        # `place` is usually an interface, one level below its device, maybe behind several hubs.
        usb = next((at for at in (place, *place.parents) if _PORT.fullmatch(at.name)), None)
        if usb is None:
            continue
        name = _text(root / f"proc/asound/card{number}/id") or _text(sound / f"card{number}/id")
        cards[str(usb)].append(AlsaCard(number, name, tuple(sorted(playback[number]))))
    return cards


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        return b""


def _text(path: Path) -> str:
    """Return a file's text; line breaks and other unprintable characters are replaced."""
    text = _bytes(path).decode("utf-8", "replace").strip()
    return "".join(sign if sign.isprintable() else "\N{REPLACEMENT CHARACTER}" for sign in text)


def _number(path: Path, pattern: str) -> str:
    match = re.match(pattern, _text(path))
    return match[0] if match else ""
