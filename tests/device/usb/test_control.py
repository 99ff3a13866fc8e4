"""Volume, mute and rate of a device: what is sent and understood; never louder than meant."""

import errno
import math
import struct
from contextlib import suppress
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest
import usb.core
from hypothesis import given
from hypothesis import strategies as st

from device.errors import NoUsbDeviceError, UsageError, UsbAccessError
from device.usb import requests
from device.usb.control import ControlState, UsbControl
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

    def ctrl_transfer(
        self, request_type: int, request: int, value: int, index: int, data: Any, timeout: int
    ) -> bytes | int:
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
def test_the_volume_is_read_in_db_with_its_range(uac):
    control, _ = rig(uac)
    for channel in control.volume_channels:
        assert control.volume_db(channel) == -8.0
        assert control.volume_range(channel) == VolumeRange(-64.0, 0.0, 0.5)


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
def test_mute_and_rate_are_read_and_set(uac):
    control, dac = rig(uac)
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
