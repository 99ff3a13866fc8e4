"""What /proc/asound looks like, written anew: cards of every kind without any card."""

import shutil
from pathlib import Path

from tests.support.data import text

ASYNC = text("asound/async")
"""A UAC2 device: 16 and 24 bits, and a format that nobody here plays."""

RUNNING = ASYNC.replace(
    "  Status: Stop\n",
    "  Status: Running\n    Interface = 1\n    Altset = 2\n    Packet Size = 104\n"
    "    Momentary freq = 48002 Hz (0x6.0010)\n    Feedback Format = 16.16\n",
    1,
)

ADAPTIVE = text("asound/adaptive")
"""A UAC1 device with a range of rates."""

PCM_INFO = "card: 1\ndevice: 0\nid: USB Audio\nname: {}\n"

STATUS = "state: RUNNING\nowner_pid   : {}\ntrigger_time: 1.0\n-----\ndelay       : 768\n"

HW_PARAMS = text("asound/hw_params")


class Cards:
    """A folder that looks like /proc/asound; cards come and go while it is read."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._lines: dict[int, str] = {}
        root.mkdir(parents=True, exist_ok=True)
        self._write()

    def plug(
        self,
        number: int,
        card_id: str,
        *,
        stream: str = "",
        usb_id: str = "",
        devices: tuple[int, ...] = (0,),
        captures: tuple[int, ...] = (),
    ) -> Path:
        """Make a card and return its folder; without `stream` it is no USB card."""
        driver = "USB-Audio" if stream else "HDA-Intel"
        self._lines[number] = (
            f"{number:2d} [{card_id:<15}]: {driver} - {card_id} card\n"
            f"                      Maker {card_id} at somewhere\n"
        )
        folder = self.root / f"card{number}"
        sides = [(device, "p", "output") for device in devices]
        for device, side, name in [*sides, *((device, "c", "input") for device in captures)]:
            pcm = folder / f"pcm{device}{side}"
            (pcm / "sub0").mkdir(parents=True)
            (pcm / "info").write_text(PCM_INFO.format(f"{name} {device}"))
            (pcm / "sub0" / "status").write_text("closed\n")
            (pcm / "sub0" / "hw_params").write_text("closed\n")
            if stream:
                (folder / f"stream{device}").write_text(stream)
        folder.mkdir(exist_ok=True)
        if usb_id:
            (folder / "usbid").write_text(f"{usb_id}\n")
        self._write()
        return folder

    def unplug(self, number: int) -> None:
        del self._lines[number]
        self._write()
        shutil.rmtree(self.root / f"card{number}")

    def use(self, number: int, process: int, pcm: str = "pcm0p") -> None:
        """Have a process use a device; 0 for none."""
        status = self.root / f"card{number}/{pcm}/sub0/status"
        status.write_text(STATUS.format(process) if process else "closed\n")

    def _write(self) -> None:
        lines = "".join(text for _, text in sorted(self._lines.items()))
        (self.root / "cards").write_text(lines or "--- no soundcards ---\n")
