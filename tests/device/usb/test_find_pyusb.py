"""What PyUSB is asked, and what is said where it cannot be: PyUSB itself, on a backend of ours."""

from __future__ import annotations

import array
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import usb.backend
import usb.core
from usb.backend import libusb1

from device.usb import NoLibusbError, NoUsbDeviceError, UsbAccessError, find_devices
from device.usb.control import (
    libusb,
    open_device,
    read_descriptors,
)
from device.usb.sysfs import UsbAudioDevice
from tests.support.usb_tree import UsbTree

DEVICE = bytes([18, 1, 0, 2, 0, 0, 0, 64, 0x8C, 0x0D, 0x14, 0, 0, 1, 1, 2, 3, 1])
CONFIGURATION = bytes([9, 2, 12, 0, 1, 1, 0, 0x80, 50, 3, 0x24, 1])
STRINGS = {1: "Maker", 2: "DAC\n2", 3: "A42"}


class Backend(usb.backend.IBackend):  # type: ignore[misc]
    """One device, and the error that opening it or asking it ends with."""

    def __init__(self, opening: int | None = None, asking: int | None = None, here: bool = True):
        self.opening, self.asking, self.here = opening, asking, here
        self.closed = 0

    def enumerate_devices(self) -> Iterator[int]:
        return iter([1] if self.here else [])

    def get_device_descriptor(self, dev: int) -> SimpleNamespace:
        strings = {"iManufacturer": 1, "iProduct": 2, "iSerialNumber": 3}
        place = {"bus": 1, "address": 5, "port_number": 2, "port_numbers": (2,), "speed": 3}
        return SimpleNamespace(
            bLength=18,
            bDescriptorType=1,
            bcdUSB=0x200,
            bDeviceClass=0,
            bDeviceSubClass=0,
            bDeviceProtocol=0,
            bMaxPacketSize0=64,
            idVendor=0x0D8C,
            idProduct=0x0014,
            bcdDevice=0x100,
            bNumConfigurations=1,
            **strings,
            **place,
        )

    def open_device(self, dev: int) -> int:
        if self.opening is not None:
            raise usb.core.USBError("Access denied", -3, self.opening)
        return 1

    def close_device(self, dev_handle: int) -> None:
        self.closed += 1

    def ctrl_transfer(self, handle, kind, request, value, index, buffer, timeout) -> int:
        if self.asking is not None:
            raise usb.core.USBError("Pipe error", -9, self.asking)
        number = value & 0xFF
        if value >> 8 == 3:
            text = STRINGS[number].encode("utf-16-le") if number else b"\x09\x04"
            answer = bytes([len(text) + 2, 3]) + text
        else:
            answer = {1: DEVICE, 2: CONFIGURATION}[value >> 8]
        answer = answer[: len(buffer)]
        buffer[: len(answer)] = array.array("B", answer)
        return len(answer)


@pytest.fixture(autouse=True)
def _chosen_anew() -> Iterator[None]:
    libusb.cache_clear()
    yield
    libusb.cache_clear()


@pytest.fixture
def device(tmp_path: Path) -> UsbAudioDevice:
    """A DAC of which the kernel tells its ids and its product, and no more."""
    tree = UsbTree(tmp_path)
    tree.plug(manufacturer=None, product="DAC", serial=None, descriptors=None)
    return find_devices(tree.root).devices[0]


def chosen(monkeypatch: pytest.MonkeyPatch, backend: object) -> None:
    monkeypatch.setattr(libusb1, "get_backend", lambda: backend)


def test_without_libusb_the_error_says_what_to_install(device, monkeypatch):
    chosen(monkeypatch, None)
    with pytest.raises(NoLibusbError, match=r"no libusb: .* sudo apt install libusb-1.0-0"):
        open_device(device)


def test_without_pyusb_the_error_says_what_to_install(device, monkeypatch):
    monkeypatch.setitem(sys.modules, "usb.backend", None)
    with pytest.raises(NoLibusbError, match=r"PyUSB is not installed; .*haptic-cushion\[live\]"):
        open_device(device)


def test_libusb_is_looked_for_until_it_is_there_and_then_no_more(monkeypatch):
    asked: list[int] = []

    def get_backend():
        asked.append(len(asked))
        return None if len(asked) == 1 else "libusb"

    monkeypatch.setattr(libusb1, "get_backend", get_backend)
    with pytest.raises(NoLibusbError):
        libusb()
    assert [libusb(), libusb()] == ["libusb", "libusb"]
    assert asked == [0, 1]


def test_what_sys_has_is_not_asked_of_the_device(tmp_path, monkeypatch):
    tree = UsbTree(tmp_path)
    tree.plug(serial="S", descriptors=DEVICE)
    device = find_devices(tree.root).devices[0]
    chosen(monkeypatch, None)
    assert read_descriptors(device) == DEVICE


def test_descriptors_come_from_the_device_as_they_would_lie_in_sys(device, monkeypatch):
    backend = Backend()
    chosen(monkeypatch, backend)
    assert read_descriptors(device) == DEVICE + CONFIGURATION
    assert backend.closed == 1


def test_without_permission_the_error_says_what_the_udev_rule_would_add(device, monkeypatch):
    chosen(monkeypatch, Backend(opening=13))
    with pytest.raises(UsbAccessError, match=r"errno 13.*cushion install-service --udev") as caught:
        read_descriptors(device)
    assert 'TAG+="uaccess"' in str(caught.value)
    assert str(device.node) in str(caught.value)


@pytest.mark.parametrize(
    ("errno", "error", "what"),
    [(19, NoUsbDeviceError, "pulled out"), (32, UsbAccessError, "does not answer")],
)
def test_a_device_that_goes_or_fails_while_it_is_asked_is_told_apart(
    device, monkeypatch, errno, error, what
):
    backend = Backend(asking=errno)
    chosen(monkeypatch, backend)
    with pytest.raises(error, match=what):
        read_descriptors(device)
    assert backend.closed == 1


def test_a_device_that_libusb_does_not_see_is_an_error_of_its_own(device, monkeypatch):
    chosen(monkeypatch, Backend(here=False))
    with pytest.raises(NoUsbDeviceError, match="libusb does not see 'DAC' at"):
        open_device(device)


def test_another_device_at_the_same_address_is_not_taken_for_it(tmp_path, monkeypatch):
    tree = UsbTree(tmp_path)
    tree.plug(ids="1209:dac1")
    chosen(monkeypatch, Backend())
    with pytest.raises(NoUsbDeviceError):
        open_device(find_devices(tree.root).devices[0])
