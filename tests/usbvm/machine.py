"""A virtual machine with USB sound cards and this machine's own files, for one command.

Its root is this machine's, read only, under a layer in memory, so that the command is found where
it is here; one folder is shared both ways. Each card is one of QEMU's, class 1.0, 48 kHz, 16 bits,
stereo; what it was sent is a WAV file. Time inside counts instructions and leaps where there is
nothing to do, which makes reading a file take long: nothing is late because this machine is busy.

Inside, a file `orders/N` in the shared folder asks for something of `ORDERS` by its name and waits
until it is gone.
"""

import json
import os
import shutil
import socket
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.support.data import text

ROOT = Path(__file__).resolve().parents[2]
KERNEL = ROOT / ".cache/usb-vm"
QEMU = "qemu-system-x86_64"
MODULES_AT_START = ("virtio_pci", "9pnet_virtio", "9p", "overlay")
SERIAL = "SN1"  # of every card: else QEMU makes one of the port
BUFFER_FRAMES = 32 * 48  # of QEMU's cards: 32 packets of 1 ms, dropped when a stream ends
BUS_OF_QEMU, BUS_OF_SOFTWARE = "xhci-pci", "vhci-hcd"
POLL_S = 0.02

_INIT = text("vm-init.sh")

_START = text("vm-start.sh")  # with gaps


def why_not() -> str:
    """What is missing for such machines, "" for nothing."""
    if not (KERNEL / "ready").is_file():
        return "no kernel for the virtual machine; run tools/fetch_usb_vm.sh"
    for program in (QEMU, "busybox", "cpio"):
        if not shutil.which(program):
            return f"{program} is missing; run tools/fetch_usb_vm.sh"
    return ""


class Machine:
    """A machine that is started by `run`, once.

    shared: a folder, empty, by the same path inside. cards: names of QEMU's cards that are plugged
    in from the start, into ports 1, 2 and so on; what each is sent is in `shared`/NAME.wav, and
    in NAME-again.wav once it was plugged in again, which may happen once. Without cards there is
    a virtual host controller for those in software.
    """

    def __init__(self, shared: Path, cards: Sequence[str] = ()) -> None:
        self._shared = shared
        self._cards = list(cards)
        self._monitor: Any = None

    def run(self, command: Sequence[str], limit_s: float) -> int:
        """Start, run the command inside as root, stop; its exit code.

        What it wrote is in `shared`/output. AssertionError: it did not end within limit_s.
        """
        shared = self._shared
        (shared / "orders").mkdir()
        bus, words = BUS_OF_QEMU if self._cards else BUS_OF_SOFTWARE, map("'{}'".format, command)
        inside = {"kernel": KERNEL, "bus": bus, "root": ROOT, "shared": shared}
        (shared / "start").write_text(_START.format(**inside, command=" ".join(words)))
        deadline_s = time.monotonic() + limit_s
        with (shared / "qemu.log").open("wb") as log:
            process = subprocess.Popen(self._arguments(), stdout=log, stderr=log)
        try:
            self._connect(process, deadline_s)
            while process.poll() is None and time.monotonic() < deadline_s:
                self._obey()
                time.sleep(POLL_S)
        finally:
            process.kill()
            process.wait()
            if self._monitor is not None:
                self._monitor.close()
        told = [shared / name for name in ("output", "console.log", "qemu.log")]
        tails = "".join(each.read_text(errors="replace")[-2_000:] for each in told if each.exists())
        assert (shared / "code").exists(), f"it did not end: {tails}"
        return int((shared / "code").read_text())

    def _arguments(self) -> list[str]:
        shared = self._shared
        kernel = KERNEL / f"boot/vmlinuz-{(KERNEL / 'ready').read_text().strip()}"
        words = f"console=ttyS0 quiet panic=-1 mitigations=off tsc=reliable shared={shared}"
        files = "local,security_model=none"
        arguments = [
            *(QEMU, "-accel", "tcg", "-cpu", "max", "-smp", "1", "-m", "1024"),
            *("-icount", "shift=0,sleep=off"),
            *("-display", "none", "-no-reboot", "-nodefaults"),
            *("-serial", f"file:{shared}/console.log"),
            *("-qmp", f"unix:{shared}/monitor,server=on,wait=off"),
            *("-kernel", str(kernel), "-initrd", str(first_files(shared)), "-append", words),
            *("-fsdev", f"{files},id=root,path=/,readonly=on,multidevs=remap"),
            *("-device", "virtio-9p-pci,fsdev=root,mount_tag=root"),
            *("-fsdev", f"{files},id=shared,path={shared}"),
            *("-device", "virtio-9p-pci,fsdev=shared,mount_tag=shared"),
            *("-device", "virtio-rng-pci", "-device", "qemu-xhci,id=usb"),
        ]
        for port, name in enumerate(self._cards, 1):
            for sound in (name, f"{name}-again"):
                path = shared / f"{sound}.wav"
                arguments += ["-audiodev", f"wav,id={sound},path={path},out.frequency=48000"]
            device = f"usb-audio,audiodev={name},id={name},serial={SERIAL},bus=usb.0,port={port}"
            device += f",buffer={4 * BUFFER_FRAMES}"
            arguments += ["-device", device]
        return arguments

    def _connect(self, process: subprocess.Popen[bytes], deadline_s: float) -> None:
        with socket.socket(socket.AF_UNIX) as monitor:
            while True:
                try:
                    monitor.connect(str(self._shared / "monitor"))
                    break
                except OSError:
                    assert process.poll() is None, (self._shared / "qemu.log").read_text()
                    assert time.monotonic() < deadline_s, "QEMU does not answer"
                    time.sleep(POLL_S)
            self._monitor = monitor.makefile("rwb")  # stays open by itself
        self._monitor.readline()
        self._ask("qmp_capabilities")

    def _ask(self, name: str, **arguments: str | int) -> None:
        order = {"execute": name, "arguments": arguments}
        self._monitor.write(json.dumps(order).encode() + b"\n")
        self._monitor.flush()
        while True:
            answer = json.loads(self._monitor.readline())
            if "event" not in answer:
                assert "return" in answer, answer
                return

    def _obey(self) -> None:
        for order in sorted((self._shared / "orders").glob("*.order")):
            what, name, *rest = order.read_text().split()
            if what == "unplug":
                self._ask("device_del", id=name)
            else:
                (port,) = rest
                card: dict[str, Any] = {"driver": "usb-audio", "buffer": 4 * BUFFER_FRAMES}
                card |= {"bus": "usb.0", "serial": SERIAL, "id": name, "port": port}
                self._ask("device_add", **card, audiodev=f"{name}-again")
            order.unlink()


def first_files(folder: Path) -> Path:
    """The file system that the kernel starts with, as a file in the folder."""
    release = (KERNEL / "ready").read_text().strip()
    root = folder / "initrd"
    for name in ("bin", "dev", "proc", "sys", "lower", "layer", "new", "modules"):
        (root / name).mkdir(parents=True)
    busybox: Any = shutil.which("busybox")
    shutil.copy(busybox, root / "bin/busybox")
    found: dict[str, None] = {}
    for module in MODULES_AT_START:
        asks = ["/sbin/modprobe", "-d", str(KERNEL), "-S", release, "--show-depends", module]
        listed = subprocess.check_output(asks, text=True)
        lines = (line.split() for line in listed.splitlines())
        found |= {words[1]: None for words in lines if words[0] == "insmod"}
    for number, path in enumerate(found):
        shutil.copy(path, root / f"modules/{number:02}-{Path(path).name}")
    (root / "init").write_text(_INIT)
    (root / "init").chmod(0o755)
    names = "".join(f"{path.relative_to(root)}\n" for path in sorted(root.rglob("*")))
    packing = ["cpio", "-o", "-H", "newc", "--quiet"]
    image = folder / "initrd.cpio"
    image.write_bytes(subprocess.check_output(packing, input=names.encode(), cwd=root))
    shutil.rmtree(root)
    return image


def order(shared: Path, *words: str) -> None:
    """Inside: ask for an `unplug NAME` or `plug NAME PORT`, and wait until it was done."""
    name = shared / "orders" / f"{time.monotonic_ns()}.{os.getpid()}"
    name.write_text(" ".join(words))
    asked = name.with_suffix(".order")
    name.rename(asked)
    while asked.exists():
        time.sleep(POLL_S)
