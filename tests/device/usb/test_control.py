import array
import errno
import math
import struct
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest
import usb.backend
import usb.core
from hypothesis import given
from hypothesis import strategies as st
from usb.backend import libusb1

from device.errors import NoLibusbError, NoUsbDeviceError, UsageError, UsbAccessError
from device.usb import requests
from device.usb.control import ControlState, UsbControl, libusb, open_device, read_descriptors
from device.usb.descriptors import RateRange, parse_configuration, playback_formats
from device.usb.requests import VolumeRange
from tests.support.usb_shapes import async_dac, controls_of, headset_adapter, plain_dac
from tests.support.usbmock.software_dac import SoftwareDac

DEVICE: Any = SimpleNamespace(label="Soft DAC", node="/dev/bus/usb/001/005")
both = pytest.mark.parametrize("uac", [1, 2])
ONE_VALUE = {"volume_range": (-0x1400, -0x1400, 0)}
units = st.integers(-0x7FFF, 0x7FFF)


@dataclass
class Wire:
    """What PyUSB's device does, straight to a software DAC; error: raised instead of an answer."""

    dac: SoftwareDac
    error: int = 0

    def ctrl_transfer(self, request_type, request, value, index, data, timeout) -> bytes | int:
        assert timeout > 0
        if self.error:
            raise usb.core.USBError("no", errno=self.error)
        asks = isinstance(data, int)
        length = data if asks else len(data)
        setup = struct.pack("<BBHHH", request_type, request, value, index, length)
        answer = self.dac.control(setup, b"" if asks else bytes(data))
        if answer is None:
            raise usb.core.USBError("pipe", errno=errno.EPIPE)
        return answer if asks else length


def rig(uac: int, **options: Any) -> tuple[UsbControl, SoftwareDac]:
    configuration = headset_adapter() if uac == 1 else plain_dac()
    formats = playback_formats(parse_configuration(configuration))
    dac = SoftwareDac(b"", uac, [], **(controls_of(configuration) | options))
    return UsbControl(DEVICE, formats[0], Wire(dac)), dac


@both
@pytest.mark.parametrize(
    ("options", "wanted_db", "limit_db", "set_db"),
    [
        ({}, -20.0, 0.0, -20.0),
        ({}, -20.2, 0.0, -20.5),  # the step below, never above
        ({}, 6.0, 0.0, 0.0),
        ({}, 6.0, 12.0, 0.0),
        ({}, 0.0, -12.3, -12.5),
        ({}, -90.0, 0.0, -64.0),
        ({}, -math.inf, 0.0, -math.inf),
        ({}, math.inf, -6.0, -6.0),
        ({"ignores": True}, -8.0, 0.0, -8.0),
        (ONE_VALUE, 0.0, 0.0, -20.0),
        (ONE_VALUE, -30.0, 0.0, -20.0),  # who asked sees that it is louder
    ],
)
def test_what_is_set_is_never_above_0_db_nor_the_limit(uac, options, wanted_db, limit_db, set_db):
    control, dac = rig(uac, **options)
    channel = control.volume_channels[0]
    assert control.set_volume_db(channel, wanted_db, limit_db) == set_db
    assert dac.volumes[channel] == (-0x8000 if set_db == -math.inf else 256 * set_db)


@given(st.floats(-200.0, 100.0), st.floats(-100.0, 50.0), units, units, st.integers(0, 0x7FFF))
def test_no_step_of_a_device_is_above_what_is_allowed(wanted_db, limit_db, one, other, step):
    lowest, highest = sorted((one, other))
    packed = (struct.pack("<h", units) for units in (lowest, highest, step))
    offered = requests.volume_range(*packed)
    try:
        limit_volume_db = offered.allowed(wanted_db, limit_db)
    except UsageError:
        assert offered.lowest_db > min(0.0, limit_db)
        return
    units = requests.volume_units(limit_volume_db)
    assert units <= 256 * min(0.0, limit_db) + 1e-6
    assert lowest <= units <= highest
    assert units <= 256 * wanted_db + 1e-6 or units == lowest


@both
@pytest.mark.parametrize(
    ("options", "kind", "says", "left_db"),
    [
        ({"volume_range": (0x100, -0x100, 1)}, UsbAccessError, "valid range; its volume is", -8.0),
        ({"volume_range": (0x200, 0x600, 0x80)}, UsageError, r"\+2.00 dB, above the limit", -8.0),
        ({"ignores": True}, UsbAccessError, "takes -30 dB for channel 1 but then reports -8", -8.0),
        ({"real_range": (-0x1400, 0)}, UsbAccessError, "takes -30 dB", -20.0),  # not what it tells
    ],
)
def test_a_volume_that_a_device_cannot_have_is_told(uac, options, kind, says, left_db):
    control, dac = rig(uac, **options)
    before, channel = dict(dac.volumes), control.volume_channels[0]
    with pytest.raises(kind, match=says):
        control.set_volume_db(channel, -30.0)
    assert dac.volumes == {**before, channel: 256 * left_db}


@both
def test_a_device_that_goes_between_set_and_read_back_was_pulled_out(uac):
    control, dac = rig(uac)
    answers = dac.control

    def once(setup: bytes, data: bytes) -> bytes | None:
        if not setup[0] & 0x80:
            control._handle.error = errno.ENODEV
        return answers(setup, data)

    dac.control = once  # type: ignore[method-assign]
    with pytest.raises(NoUsbDeviceError, match="pulled out"):
        control.set_volume_db(control.volume_channels[0], -30.0)


@both
def test_volume_with_its_range_mute_and_rate_are_read_and_set(uac):
    control, dac = rig(uac)
    for channel in control.volume_channels:
        assert control.volume_db(channel) == -8.0
        assert control.volume_range(channel) == VolumeRange(-64.0, 0.0, 0.5)
    for channel in control.mute_channels:
        assert not control.muted(channel)
        control.set_muted(channel, True)
        assert (control.muted(channel), dac.mutes[channel]) == (True, 1)
    assert control.samplerate() == 44_100
    control.set_samplerate(48_000)
    assert dac.samplerate == control.samplerate() == 48_000
    with pytest.raises(UsbAccessError, match="it stalls"):
        control.set_samplerate(12_345)
    with pytest.raises(UsageError, match="not possible"):
        control.set_samplerate(0)


def test_the_clock_of_2_0_says_what_it_offers_but_of_several_none_is_asked():
    assert rig(2)[0].samplerates() == (RateRange(44_100, 44_100), RateRange(48_000, 48_000))
    playback = playback_formats(parse_configuration(async_dac()))[0]
    dac = SoftwareDac(b"", 2, [])
    with pytest.raises(UsbAccessError, match="the clock in use is not known"):
        UsbControl(DEVICE, playback, Wire(dac)).samplerate()
    assert dac.log == []


@both
def test_what_was_set_is_set_back_but_never_too_loud_again(uac):
    control, dac = rig(uac, volume_range=(-0x4000, 0x600, 0x80))
    channel = control.volume_channels[0]
    dac.volumes[channel] = 0x400
    before = control.state()
    control.set_volume_db(channel, -30.0)
    for muted in control.mute_channels:
        control.set_muted(muted, True)
    control.set_samplerate(48_000)
    control.restore(before)
    assert (dac.volumes[channel], dac.samplerate) == (0, 44_100)  # +4 dB it was
    assert not any(dac.mutes.values())


@both
def test_a_device_that_stalls_every_request_is_no_more_than_an_error_each(uac):
    control, dac = rig(uac, stalls=True)
    asks = (control.volume_db, control.volume_range, lambda one: control.set_volume_db(one, -10.0))
    for ask in (*asks, lambda _: control.samplerate()):
        with pytest.raises(UsbAccessError, match="refuses the request"):
            ask(control.volume_channels[0])
    assert control.state() == ControlState()
    control.restore(control.state())
    assert dac.log


@given(st.binary(max_size=64), st.integers(0, 5))
def test_answers_of_any_bytes_are_a_value_or_an_error_of_the_device(raw, which):
    read: list[Any] = [
        *(requests.volume_range, requests.samplerate_ranges),
        lambda answer: requests.number(answer, 2, "volume", signed=True),
        lambda answer: requests.number(answer, 4),
        lambda answer: requests.volume_range(answer, answer, answer),
        lambda answer: requests.volume_range(answer[:2], answer[2:4], answer[4:]),
    ]
    with suppress(UsbAccessError):
        read[which](raw)


DESCRIPTOR = bytes([18, 1, 0, 2, 0, 0, 0, 64, 0x8C, 0x0D, 0x14, 0, 0, 1, 1, 2, 3, 1])
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
        fields = struct.unpack("<BBHBBBBHHHBBBB", DESCRIPTOR)
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
        answer = SoftwareDac(DESCRIPTOR + CONFIGURATION, 1, []).control(setup, b"") or b""
        buffer[: len(answer)] = array.array("B", answer)
        return len(answer)


@pytest.fixture(autouse=True)
def _chosen_anew() -> Iterator[None]:
    libusb.cache_clear()
    yield
    libusb.cache_clear()


@pytest.fixture
def device(tree):
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
    tree.plug(serial="S", descriptors=DESCRIPTOR)
    chosen(monkeypatch, None)
    assert read_descriptors(tree.only) == DESCRIPTOR


def test_descriptors_come_from_the_device_as_they_would_lie_in_sys(device, monkeypatch):
    backend = Backend()
    chosen(monkeypatch, backend)
    assert (read_descriptors(device), backend.closed) == (DESCRIPTOR + CONFIGURATION, 1)
