"""What PyUSB is asked, and what is said where it cannot be: PyUSB itself, on a backend of ours."""

import array
import errno
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace

import pytest
import usb.backend
import usb.core
from usb.backend import libusb1

from device.errors import NoLibusbError, NoUsbDeviceError, UsbAccessError
from device.usb.control import libusb, open_device, read_descriptors
from tests.support.usbmock.software_dac import SoftwareDac

DEVICE = bytes([18, 1, 0, 2, 0, 0, 0, 64, 0x8C, 0x0D, 0x14, 0, 0, 1, 1, 2, 3, 1])
CONFIGURATION = bytes([9, 2, 12, 0, 1, 1, 0, 0x80, 50, 3, 0x24, 1])


@dataclass(eq=False)
class Backend(usb.backend.IBackend):  # type: ignore[misc]
    """One device, and the error that opening it or asking it ends with."""

    opening: int | None = None
    asking: int | None = None
    here: bool = True
    product: int = 0x14
    closed: int = 0

    def enumerate_devices(self) -> Iterator[int]:
        return iter([1] if self.here else [])

    def get_device_descriptor(self, dev: int) -> SimpleNamespace:
        place = {"bus": 1, "address": 5, "port_number": 2, "port_numbers": (2,), "speed": 3}
        names = "bLength bDescriptorType bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol "
        names += "bMaxPacketSize0 idVendor idProduct bcdDevice iManufacturer iProduct "
        names += "iSerialNumber bNumConfigurations"
        fields = struct.unpack("<BBHBBBBHHHBBBB", DEVICE)
        known = dict(zip(names.split(), fields, strict=True)) | {"idProduct": self.product}
        return SimpleNamespace(**known, **place)

    def open_device(self, dev: int) -> int:
        if self.opening is not None:
            raise usb.core.USBError("Access denied", -3, self.opening)
        return 1

    def close_device(self, dev_handle: int) -> None:
        self.closed += 1

    def ctrl_transfer(self, handle, kind, request, value, index, buffer, timeout) -> int:
        if self.asking is not None:
            raise usb.core.USBError("Pipe error", -9, self.asking)
        setup = struct.pack("<BBHHH", kind, request, value, index, len(buffer))
        answer = SoftwareDac(DEVICE + CONFIGURATION, 1, []).control(setup, b"") or b""
        buffer[: len(answer)] = array.array("B", answer)
        return len(answer)


@pytest.fixture(autouse=True)
def _chosen_anew() -> Iterator[None]:
    libusb.cache_clear()
    yield
    libusb.cache_clear()


@pytest.fixture
def device(tree):
    """A DAC of which the kernel tells its ids and its product, and no more."""
    tree.plug(manufacturer=None, product="DAC", serial=None, descriptors=None)
    return tree.only


def chosen(monkeypatch: pytest.MonkeyPatch, backend: object) -> None:
    monkeypatch.setattr(libusb1, "get_backend", lambda: backend)


@pytest.mark.parametrize(
    ("backend", "error", "words"),
    [
        (None, NoLibusbError, r"no libusb: .* sudo apt install libusb-1.0-0"),
        (Backend(opening=errno.EACCES), UsbAccessError, r'errno 13.*--udev.*TAG\+="uaccess"'),
        (Backend(asking=errno.ENODEV), NoUsbDeviceError, "001/005 was pulled out"),
        (Backend(asking=errno.EBUSY), UsbAccessError, "001/005 is held by a driver"),
        (Backend(asking=errno.ETIMEDOUT), UsbAccessError, "does not answer within 500 ms"),
        (Backend(asking=errno.EIO), UsbAccessError, "001/005 does not answer correctly"),
        (Backend(here=False), NoUsbDeviceError, "libusb does not see 'DAC' at .*001/005"),
        (Backend(product=0xDAC1), NoUsbDeviceError, "libusb does not see 'DAC'"),  # another one
    ],
)
def test_a_device_that_cannot_be_read_is_told_with_why(device, monkeypatch, backend, error, words):
    chosen(monkeypatch, backend)
    with pytest.raises(error, match=words):
        read_descriptors(device)
    assert backend is None or backend.closed == (backend.asking is not None)


def test_without_pyusb_the_error_says_what_to_install(device, monkeypatch):
    monkeypatch.setitem(sys.modules, "usb.backend", None)
    with pytest.raises(NoLibusbError, match=r"PyUSB is not installed; .*haptic-cushion\[live\]"):
        open_device(device)


def test_libusb_is_looked_for_until_it_is_there_and_then_no_more(monkeypatch):
    answers = iter([None, "libusb"])
    monkeypatch.setattr(libusb1, "get_backend", lambda: next(answers))
    with pytest.raises(NoLibusbError):
        libusb()
    assert [libusb(), libusb()] == ["libusb", "libusb"]


def test_what_sys_has_is_not_asked_of_the_device(tree, monkeypatch):
    tree.plug(serial="S", descriptors=DEVICE)
    chosen(monkeypatch, None)
    assert read_descriptors(tree.only) == DEVICE


def test_descriptors_come_from_the_device_as_they_would_lie_in_sys(device, monkeypatch):
    backend = Backend()
    chosen(monkeypatch, backend)
    assert (read_descriptors(device), backend.closed) == (DEVICE + CONFIGURATION, 1)
