"""A small /sys, /dev and /proc with USB devices in it, laid out as the kernel does."""

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from device.usb import UsbAudioDevice, find_devices

CONTROL, STREAMING, MIDI = (1, 1), (1, 2), (1, 3)
HID = (3, 0)
DAC = (CONTROL, STREAMING)

HOST = "devices/pci0000:00/0000:00:14.0"


class UsbTree:
    """A tree below `root` with one bus; `plug` and `unplug` do what the kernel would."""

    def __init__(self, root: Path, bus: bool = True) -> None:
        self.root = root
        self.sys = root / "sys"
        self.gone = root / "gone"
        for folder in ("sys", "dev", "proc"):
            (root / folder).mkdir(parents=True, exist_ok=True)
        if bus:
            hub = self.sys / HOST / "usb1"
            hub.mkdir(parents=True)
            self._list(hub)
            (root / "dev/bus/usb/001").mkdir(parents=True)

    def plug(
        self,
        port: str = "1-2",
        ids: str = "0d8c:0014",
        *,
        address: int = 5,
        serial: str | bytes | None = None,
        manufacturer: str | bytes | None = "C-Media",
        product: str | bytes | None = "USB Audio",
        interfaces: Sequence[tuple[int, int]] = DAC,
        driver: str | None = "snd-usb-audio",
        card: int | None = None,
        card_id: str = "DAC",
        playback: Sequence[int] = (0,),
        descriptors: bytes | None = b"\x12\x01",
    ) -> Path:
        """Plug a device in and return its folder below /sys/devices. card: None for none."""
        bus, folder = int(port.partition("-")[0]), self.path(port)
        folder.mkdir(parents=True)
        vendor, product_id = ids.split(":")
        self._write(folder, {"busnum": bus, "devnum": address, "speed": 480})
        self._write(folder, {"idVendor": vendor, "idProduct": product_id, "bMaxPower": "100mA"})
        self._write(folder, {"manufacturer": manufacturer, "product": product, "serial": serial})
        if descriptors is not None:
            (folder / "descriptors").write_bytes(descriptors)
        node = self.root / f"dev/bus/usb/{bus:03d}/{address:03d}"
        if node.parent.is_dir():
            node.touch()
        self._list(folder)
        for number, (kind, subclass) in enumerate(interfaces):
            interface = folder / f"{port}:1.{number}"
            interface.mkdir()
            known = {"Number": number, "Class": kind, "SubClass": subclass, "Protocol": 0x20}
            self._write(interface, {f"bInterface{name}": f"{n:02x}" for name, n in known.items()})
            if driver is not None and kind == 1:
                (self.sys / "bus/usb/drivers" / driver).mkdir(parents=True, exist_ok=True)
                (interface / "driver").symlink_to(self.sys / "bus/usb/drivers" / driver)
            self._list(interface)
        if card is not None:
            self._card(folder / f"{port}:1.0", card, card_id, playback)
        return folder

    def add_built_in_card(self, number: int) -> None:
        self._card(self.sys / "devices/pci0000:00/0000:00:1f.3", number, "PCH", (0,))

    @property
    def devices(self) -> tuple[UsbAudioDevice, ...]:
        return find_devices(self.root).devices

    @property
    def only(self) -> UsbAudioDevice:
        (device,) = self.devices
        return device

    @property
    def ports(self) -> list[str]:
        return [device.port for device in self.devices]

    def unplug(self, port: str) -> None:
        folder, bus = self.path(port), self.sys / "bus/usb/devices"
        node = (int((folder / name).read_text()) for name in ("busnum", "devnum"))
        (self.root / "dev/bus/usb/{:03d}/{:03d}".format(*node)).unlink(missing_ok=True)
        for link in (*bus.iterdir(), *self._in(self.sys / "class/sound")):
            if link.resolve().is_relative_to(folder):
                link.unlink()
        for card in self._in(self.root / "proc/asound"):
            if not (self.sys / "class/sound" / card.name).exists():
                shutil.rmtree(card)
        # kept, since a disk would give the next folder its inode, and the kernel never does
        self.gone.mkdir(exist_ok=True)
        folder.rename(self.gone / str(len(self._in(self.gone))))

    def path(self, port: str) -> Path:
        """Where a port's device lies: below the hub that the port is of."""
        bus, _, chain = port.partition("-")
        numbers = chain.split(".")
        folders = [f"{bus}-{'.'.join(numbers[: n + 1])}" for n in range(len(numbers))]
        return self.sys.joinpath(HOST, f"usb{bus}", *folders)

    def _card(self, parent: Path, number: int, card_id: str, playback: Sequence[int]) -> None:
        card = parent / f"sound/card{number}"
        card.mkdir(parents=True)
        (card / "device").symlink_to(parent)
        self._write(card, {"id": card_id, "number": number})
        self._list(card, "class/sound")
        for device in playback:
            pcm = card / f"pcmC{number}D{device}p"
            pcm.mkdir()
            self._list(pcm, "class/sound")
        asound = self.root / f"proc/asound/card{number}"
        asound.mkdir(parents=True)
        self._write(asound, {"id": card_id})

    def _list(self, folder: Path, where: str = "bus/usb/devices") -> None:
        listing = self.sys / where
        listing.mkdir(parents=True, exist_ok=True)
        (listing / folder.name).symlink_to(os.path.relpath(folder, listing))

    @staticmethod
    def _write(folder: Path, attributes: Mapping[str, str | int | bytes | None]) -> None:
        for name, told in attributes.items():
            if told is not None:
                content = told if isinstance(told, bytes) else str(told).encode()
                (folder / name).write_bytes(content + b"\n")

    @staticmethod
    def _in(folder: Path) -> list[Path]:
        return list(folder.iterdir()) if folder.is_dir() else []
