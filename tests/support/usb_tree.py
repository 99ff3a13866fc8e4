"""A small /sys, /dev and /proc with USB devices in it, laid out as the kernel does."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

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
            self.add_bus(1)

    def add_bus(self, number: int) -> None:
        hub = self.sys / HOST / f"usb{number}"
        hub.mkdir(parents=True)
        self._list(hub)
        (self.root / f"dev/bus/usb/{number:03d}").mkdir(parents=True)

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
        bus = int(port.partition("-")[0])
        folder = self.path(port)
        folder.mkdir(parents=True)
        vendor, product_id = ids.split(":")
        self._write(
            folder,
            busnum=str(bus),
            devnum=str(address),
            idVendor=vendor,
            idProduct=product_id,
            speed="480",
            bMaxPower="100mA",
            manufacturer=manufacturer,
            product=product,
            serial=serial,
        )
        if descriptors is not None:
            (folder / "descriptors").write_bytes(descriptors)
        node = self.root / f"dev/bus/usb/{bus:03d}/{address:03d}"
        if node.parent.is_dir():
            node.touch()
        self._list(folder)
        for number, (kind, subclass) in enumerate(interfaces):
            interface = folder / f"{port}:1.{number}"
            interface.mkdir()
            self._write(
                interface,
                bInterfaceNumber=f"{number:02x}",
                bInterfaceClass=f"{kind:02x}",
                bInterfaceSubClass=f"{subclass:02x}",
                bInterfaceProtocol="20",
            )
            if driver is not None and kind == 1:
                (self.sys / "bus/usb/drivers" / driver).mkdir(parents=True, exist_ok=True)
                (interface / "driver").symlink_to(self.sys / "bus/usb/drivers" / driver)
            self._list(interface)
        if card is not None:
            self.add_card(port, card, card_id, playback)
        return folder

    def add_card(
        self, port: str, number: int, card_id: str = "DAC", playback: Sequence[int] = (0,)
    ) -> None:
        """Make a sound card of a device's first interface, as its driver does a little later."""
        interface = self.path(port) / f"{port}:1.0"
        self._card(interface, number, card_id, playback)

    def add_built_in_card(self, number: int) -> None:
        self._card(self.sys / "devices/pci0000:00/0000:00:1f.3", number, "PCH", (0,))

    def unplug(self, port: str) -> None:
        folder = self.path(port)
        bus = self.sys / "bus/usb/devices"
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
        self._write(card, id=card_id, number=str(number))
        self._list(card, "class/sound")
        for device in playback:
            pcm = card / f"pcmC{number}D{device}p"
            pcm.mkdir()
            self._list(pcm, "class/sound")
        asound = self.root / f"proc/asound/card{number}"
        asound.mkdir(parents=True)
        self._write(asound, id=card_id)

    def _list(self, folder: Path, where: str = "bus/usb/devices") -> None:
        listing = self.sys / where
        listing.mkdir(parents=True, exist_ok=True)
        (listing / folder.name).symlink_to(os.path.relpath(folder, listing))

    @staticmethod
    def _write(folder: Path, **attributes: str | bytes | None) -> None:
        for name, text in attributes.items():
            if text is not None:
                content = text.encode() if isinstance(text, str) else text
                (folder / name).write_bytes(content + b"\n")

    @staticmethod
    def _in(folder: Path) -> list[Path]:
        return list(folder.iterdir()) if folder.is_dir() else []
