"""Plugs software devices into a testbed of umockdev and runs a command that sees them as real.

    umockdev-wrapper /usr/bin/python3 -m tests.support.usbmock.serve SCENE -- COMMAND...

Runs under the system's Python, which has the bindings of umockdev. SCENE is JSON: a list of
devices (see `Plugged`). The device files are answered here as the kernel's usbfs answers: claims,
drivers, control transfers and their errors. Lines on the pipe named by CUSHION_USBMOCK unplug a
device ("unplug PORT") or plug it in again ("plug PORT [ADDRESS]").
"""

import errno
import json
import os
import struct
import subprocess
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import gi

gi.require_version("UMockdev", "1.0")
from gi.repository import GLib, UMockdev  # noqa: E402

from tests.support.usbmock.software_dac import SoftwareDac  # noqa: E402
from tests.support.usbmock.software_mixer import SoftwareMixer  # noqa: E402

# linux/usbdevice_fs.h, 64 bit
CLAIM, RELEASE = 0x8004550F, 0x80045510
SUBMIT, REAP, REAP_NOW, DISCARD = 0x8038550A, 0x4008550C, 0x4008550D, 0x550B
GET_DRIVER, INTERFACE_IOCTL, CAPABILITIES = 0x41045508, 0xC0105512, 0x8004551A
SET_INTERFACE, SET_CONFIGURATION = 0x80085504, 0x80045505
DISCONNECT, CONNECT = 22, 23
CONTROL_URB = 2
DRIVER = "snd-usb-audio"


class Plugged:
    """One device on the testbed.

    port: such as "1-2"; address: on bus 1; vendor, product: numbers; bound: whether the driver
    holds it; dac: arguments of `SoftwareDac`, its descriptors in hex; card: of ALSA, or None;
    mixer: arguments of the card's `SoftwareMixer`; permission: whether it may be opened.
    """

    def __init__(self, testbed: Any, described: dict[str, Any]) -> None:
        self.testbed = testbed
        self.port, self.address = described["port"], described["address"]
        self.bound_at_plug = described.get("bound", True)
        self.card = described.get("card")
        self.permission = described.get("permission", True)
        dac = dict(described["dac"])
        descriptors = bytes.fromhex(dac.pop("descriptors"))
        for name in ("volumes", "mutes"):
            if name in dac:
                dac[name] = {int(channel): value for channel, value in dac[name].items()}
        if "volume_range" in dac:
            dac["volume_range"] = tuple(dac["volume_range"])
        self.dac = SoftwareDac(descriptors, **dac)
        self.configuration = described.get("configuration", 1)
        self.interfaces = _interfaces(descriptors[18:], self.configuration)
        self.bound: set[int] = set()
        self.claimed: set[int] = set()
        self.done: list[Any] = []
        self.handler = UMockdev.IoctlBase()
        self.handler.connect("handle-ioctl", self._on_ioctl)
        self.mixer = SoftwareMixer(**described.get("mixer", {}))
        self.mixer_handler = UMockdev.IoctlBase()
        self.mixer_handler.connect("handle-ioctl", self._on_mixer_ioctl)

    @property
    def mixer_node(self) -> str:
        return f"/dev/snd/controlC{self.card}"

    @property
    def node(self) -> str:
        return f"/dev/bus/usb/001/{self.address:03d}"

    @property
    def path(self) -> str:
        return f"/devices/pci0000:00/0000:00:14.0/usb1/{self.port}"

    def plug(self) -> None:
        self.bound = set(self.interfaces) if self.bound_at_plug else set()
        self.claimed.clear()
        self.done.clear()
        self.testbed.add_from_string(self._text())
        self.testbed.attach_ioctl(self.node, self.handler)
        if self.card is not None and self.bound:
            self.testbed.attach_ioctl(self.mixer_node, self.mixer_handler)
        if not self.permission:
            Path(self.testbed.get_root_dir() + self.node).chmod(0)

    def unplug(self) -> None:
        # As the kernel does: nothing answers any more by the time that anybody is told.
        self.testbed.detach_ioctl(self.node)
        if self.card is not None and self.bound_at_plug:
            self.testbed.detach_ioctl(self.mixer_node)
        paths = [line[3:] for line in self._text().splitlines() if line.startswith("P: ")]
        for path in reversed(paths):  # children first
            self.testbed.uevent(f"/sys{path}", "remove")
            self.testbed.remove_device(f"/sys{path}")

    def _text(self) -> str:
        raw = self.dac.descriptors
        vendor, product = (int.from_bytes(raw[at : at + 2], "little") for at in (8, 10))
        node = f"N: {self.node.removeprefix('/dev/')}={raw.hex().upper()}"
        events = "DEVTYPE=usb_device DRIVER=usb BUSNUM=001 MAJOR=189"
        events += f" DEVNAME={self.node} DEVNUM={self.address:03d} MINOR={self.address - 1}"
        attributes = f"busnum=1 devnum={self.address} devpath={self.port.partition('-')[2]}"
        attributes += f" speed={480 if self.dac.uac > 1 else 12} bDeviceClass={raw[4]:02x}"
        attributes += f" idVendor={vendor:04x} idProduct={product:04x} bNumConfigurations=1"
        attributes += f" bConfigurationValue={self.configuration}"
        strings = zip(("manufacturer", "product", "serial"), self.dac.strings, strict=False)
        told = [node, f"E: PRODUCT={vendor:x}/{product:x}/123"]
        told += [f"A: {name}={text}\\n" for name, text in strings if text]
        told += [f"H: descriptors={raw.hex().upper()}"]
        text = _block(self.path, "usb", *told, events=events, attributes=attributes)
        driver = [f"L: driver=../../../../../../bus/usb/drivers/{DRIVER}"] if self.bound else []
        for number, (of_class, subclass, protocol) in self.interfaces.items():
            attributes = f"bInterfaceNumber={number:02x} bInterfaceClass={of_class:02x}"
            attributes += f" bInterfaceSubClass={subclass:02x} bInterfaceProtocol={protocol:02x}"
            path, events = f"{self.path}/{self.port}:1.{number}", "DEVTYPE=usb_interface"
            text += _block(path, "usb", *driver, events=events, attributes=attributes)
        if self.card is not None and self.bound:
            sound = f"{self.path}/{self.port}:1.0/sound/card{self.card}"
            link = f"L: device=../../../{self.port}:1.0"
            pcm, mixer = f"pcmC{self.card}D0p", self.mixer_node.removeprefix("/dev/")
            attributes = f"id=DAC{self.card} number={self.card}"
            text += _block(sound, "sound", link, attributes=attributes)
            text += _block(f"{sound}/{pcm}", "sound", events=f"DEVNAME=/dev/snd/{pcm}")
            control, events = f"{sound}/controlC{self.card}", f"DEVNAME={self.mixer_node}"
            text += _block(control, "sound", f"N: {mixer}=00", events=events)
        return text

    def _on_ioctl(self, _: Any, client: Any) -> bool:
        return _complete(client, self._answer)

    def _on_mixer_ioctl(self, _: Any, client: Any) -> bool:
        request = client.get_request() & 0xFFFFFFFF
        return _complete(client, lambda asked: self.mixer.answer(request, asked.get_arg()))

    def _answer(self, client: Any) -> tuple[int, int]:
        request, argument = client.get_request() & 0xFFFFFFFF, client.get_arg()
        if request == CAPABILITIES:
            argument.resolve(0, 4).update(0, struct.pack("<I", 0x3F))
            return 0, 0
        if request in (CLAIM, RELEASE):
            (number,) = struct.unpack("<I", bytes(argument.resolve(0, 4).retrieve()))
            if request == CLAIM and number in self.bound:
                return -1, errno.EBUSY
            (self.claimed.add if request == CLAIM else self.claimed.discard)(number)
            return 0, 0
        if request in (SET_INTERFACE, SET_CONFIGURATION):
            return 0, 0
        if request == GET_DRIVER:
            return self._driver(argument)
        if request == INTERFACE_IOCTL:
            return self._attach_or_detach(argument)
        if request == SUBMIT:
            return self._submit(argument)
        if request in (REAP, REAP_NOW):
            if not self.done:
                return -1, errno.EAGAIN
            argument.resolve(0, 8).set_ptr(0, self.done.pop(0))
            return 0, 0
        return -1, errno.EINVAL if request == DISCARD else errno.ENOTTY

    def _driver(self, argument: Any) -> tuple[int, int]:
        answer = argument.resolve(0, 260)
        (number,) = struct.unpack("<I", bytes(answer.retrieve())[:4])
        name = DRIVER if number in self.bound else "usbfs" if number in self.claimed else ""
        if not name:
            return -1, errno.ENODATA
        answer.update(4, name.encode() + b"\0")
        return 0, 0

    def _attach_or_detach(self, argument: Any) -> tuple[int, int]:
        number, code = struct.unpack("<ii", bytes(argument.resolve(0, 16).retrieve())[:8])
        if code & 0xFF == DISCONNECT:
            if number not in self.bound:
                return -1, errno.ENODATA
            # The driver of the first interface gives back all of them, and the card is gone.
            self.bound -= set(self.interfaces) if number == 0 else {number}
            return 0, 0
        if code & 0xFF == CONNECT:
            if self.claimed or number in self.bound:
                return -1, errno.EBUSY
            self.bound |= set(self.interfaces)
            return 1, 0
        return -1, errno.ENOTTY

    def _submit(self, argument: Any) -> tuple[int, int]:
        urb = argument.resolve(0, 56)
        kind, length = struct.unpack("<B23xi", bytes(urb.retrieve())[:28])
        if kind != CONTROL_URB:
            return -1, errno.EINVAL
        buffer = urb.resolve(16, length)
        data = bytes(buffer.retrieve())
        setup = data[:8]
        request_type, number = setup[0], setup[4]
        if request_type & 0x60 == 0x20 and request_type & 0x1F == 1 and number in self.bound:
            return -1, errno.EBUSY
        asks = bool(request_type & 0x80)
        answer = self.dac.control(setup, b"" if asks else data[8:])
        if answer is not None and asks:
            buffer.update(8, answer)
        count = 0 if answer is None else len(answer) if asks else length - 8
        urb.update(4, struct.pack("<i", -errno.EPIPE if answer is None else 0))
        urb.update(28, struct.pack("<i", count))
        self.done.append(urb)
        return 0, 0


def _complete(client: Any, answer: Callable[[Any], tuple[int, int]]) -> bool:
    try:
        result, error = answer(client)
    except Exception:
        traceback.print_exc()
        result, error = -1, errno.EIO
    client.complete(result, error)
    return True


def _block(path: str, subsystem: str, *lines: str, events: str = "", attributes: str = "") -> str:
    """A device of the testbed. events, attributes: with a blank between them."""
    told = [f"E: {event}" for event in f"SUBSYSTEM={subsystem} {events}".split()]
    told += [f"A: {attribute}\\n" for attribute in attributes.split()]
    return "\n".join([f"P: {path}", *told, *lines, "", ""])


def _interfaces(configuration: bytes, value: int) -> dict[int, tuple[int, int, int]]:
    """Class, subclass and protocol of each interface of a configuration."""
    found: dict[int, tuple[int, int, int]] = {}
    of_this = False
    while len(configuration) > 2 and configuration[0] > 1:
        if configuration[1] == 2:
            of_this = configuration[5] == value
        if configuration[1] == 4 and of_this:
            of_class, subclass, protocol = configuration[5:8]
            found.setdefault(configuration[2], (of_class, subclass, protocol))
        configuration = configuration[configuration[0] :]
    return found


def main() -> int:
    """Plug in, run the command, answer until it ends; its exit code."""
    split = sys.argv.index("--")
    scene, command = json.loads(sys.argv[1]), sys.argv[split + 1 :]
    testbed = UMockdev.Testbed.new()
    devices = {each["port"]: Plugged(testbed, each) for each in scene}
    testbed.add_from_string(
        "P: /devices/pci0000:00/0000:00:14.0/usb1\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\n"
        "A: busnum=1\\n\nA: devnum=1\\n\nA: idVendor=1d6b\\n\nA: idProduct=0002\\n\n"
        "A: bDeviceClass=09\\n\n\n"
    )
    for device in devices.values():
        device.plug()
    loop, pipe = GLib.MainLoop(), f"{testbed.get_root_dir()}/control"
    os.mkfifo(pipe)
    orders = os.open(pipe, os.O_RDWR | os.O_NONBLOCK)

    def obey(descriptor: int, condition: Any) -> bool:
        for line in os.read(descriptor, 4_096).decode().splitlines():
            what, port, *address = line.split()
            if address:
                devices[port].address = int(address[0])
            (devices[port].plug if what == "plug" else devices[port].unplug)()
        return True

    GLib.io_add_watch(orders, GLib.IO_IN, obey)
    # The testbed sets its variable behind the back of os.environ.
    seen = {"UMOCKDEV_DIR": testbed.get_root_dir(), "CUSHION_USBMOCK": pipe}
    process = subprocess.Popen(command, env={**os.environ, **seen})
    code = [1]

    def ended(_: int, status: int) -> None:
        code[0] = os.waitstatus_to_exitcode(status)
        loop.quit()

    GLib.child_watch_add(GLib.PRIORITY_DEFAULT, process.pid, ended)
    loop.run()
    log = {port: device.dac.log for port, device in devices.items()}
    if "CUSHION_USBMOCK_LOG" in os.environ:
        Path(os.environ["CUSHION_USBMOCK_LOG"]).write_text(json.dumps(log), encoding="utf-8")
    return code[0]


if __name__ == "__main__":
    sys.exit(main())
