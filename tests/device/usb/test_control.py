"""Volume, mute and rate of a device: what is sent and understood; never louder than meant."""

from __future__ import annotations

import errno
import math
import struct
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import usb.core
from hypothesis import given
from hypothesis import strategies as st

from device.errors import NoUsbDeviceError, UsageError
from device.usb import UsbAccessError, UsbAudioDevice, requests
from device.usb.control import ControlState, UsbControl
from device.usb.descriptors import PlaybackFormat, RateRange, parse_configuration, playback_formats
from device.usb.requests import VolumeRange
from device.usb.sysfs import AudioInterface
from tests.support import usb_builder
from tests.support.usb_builder import (
    ASYNCHRONOUS,
    ISOCHRONOUS,
    MUTE_2,
    SPEAKER,
    STREAMING_TERMINAL,
    UAC2,
    VOLUME_2,
    clock_source,
    endpoint,
    feature_2,
    format_2,
    general_2,
    header_2,
    input_2,
    output_2,
    stream_endpoint_2,
    streaming,
)
from tests.support.usb_shapes import async_dac, headset_adapter
from tests.support.usbmock.software_dac import SoftwareDac


def plain_dac() -> bytes:
    """2.0 with one clock; mute on the master, a volume on each channel."""
    units = header_2(
        clock_source(4),
        input_2(1, STREAMING_TERMINAL, 4, 2, 3),
        feature_2(2, 1, [MUTE_2, VOLUME_2, VOLUME_2]),
        output_2(3, SPEAKER, 2, 4),
    )
    data = endpoint(1, ISOCHRONOUS | ASYNCHRONOUS, 200)
    plays = streaming(1, 1, UAC2, general_2(1, 2, 3), format_2(4, 24), data, stream_endpoint_2())
    parts = usb_builder.control(0, UAC2, units), streaming(1, 0, UAC2), plays
    return usb_builder.configuration(usb_builder.association(0, 2), *parts)


SHAPES = {1: headset_adapter, 2: plain_dac}


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


def a_device(uac: int) -> UsbAudioDevice:
    return UsbAudioDevice(
        port="1-2",
        path="/devices/usb1/1-2",
        vendor_id="1209",
        product_id="dac1",
        manufacturer="Soft",
        product="DAC",
        serial="1",
        bus=1,
        address=5,
        speed=480.0,
        max_power_ma=100,
        configuration=1,
        descriptors=usb_builder.device() + SHAPES[uac](),
        node=Path("/dev/bus/usb/001/005"),
        interfaces=(AudioInterface(0, 1, 0, ""),),
        cards=(),
    )


def rig(uac: int, **options: Any) -> tuple[UsbControl, SoftwareDac, PlaybackFormat]:
    playback = max(
        playback_formats(parse_configuration(SHAPES[uac]())), key=lambda one: one.volume_channels
    )
    usual: dict[str, Any] = {
        "unit": playback.feature_unit,
        "endpoint": playback.endpoint_address,
        "volumes": dict.fromkeys(playback.volume_channels, -0x800),
        "mutes": dict.fromkeys(playback.mute_channels, 0),
    }
    if playback.clock_sources:
        usual["clock"] = playback.clock_sources[0]
    dac = SoftwareDac(a_device(uac).descriptors, uac, ["Soft", "DAC", "1"], **(usual | options))
    return UsbControl(a_device(uac), playback, Wire(dac)), dac, playback


both = pytest.mark.parametrize("uac", [1, 2])


@both
def test_the_volume_is_read_in_db_with_its_range(uac: int) -> None:
    control, _, _ = rig(uac)
    for channel in control.volume_channels:
        assert control.volume_db(channel) == -8.0
        assert control.volume_range(channel) == VolumeRange(-64.0, 0.0, 0.5)


@both
@pytest.mark.parametrize(
    ("wanted_db", "limit_db", "set_db"),
    [
        (-20.0, 0.0, -20.0),
        (-20.2, 0.0, -20.5),  # the step below, never above
        (6.0, 0.0, 0.0),
        (6.0, 12.0, 0.0),
        (0.0, -12.3, -12.5),
        (-90.0, 0.0, -64.0),
        (-math.inf, 0.0, -math.inf),
        (math.inf, -6.0, -6.0),
    ],
)
def test_what_is_set_is_never_above_0_db_nor_the_limit(
    uac: int, wanted_db: float, limit_db: float, set_db: float
) -> None:
    control, dac, _ = rig(uac)
    channel = control.volume_channels[0]
    assert control.set_volume_db(channel, wanted_db, limit_db) == set_db
    assert dac.volumes[channel] == (-0x8000 if set_db == -math.inf else 256 * set_db)


@given(
    st.floats(-200.0, 100.0),
    st.floats(-100.0, 50.0),
    st.integers(-0x7FFF, 0x7FFF),
    st.integers(-0x7FFF, 0x7FFF),
    st.integers(0, 0x7FFF),
)
def test_whatever_a_device_offers_no_step_is_above_what_is_allowed(
    wanted_db: float, limit_db: float, one: int, other: int, step: int
) -> None:
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
def test_a_range_upside_down_is_left_alone(uac: int) -> None:
    control, dac, _ = rig(uac, volume_range=(0x100, -0x100, 1))
    before = dict(dac.volumes)
    with pytest.raises(UsbAccessError, match="not a valid range; its volume is not changed"):
        control.set_volume_db(control.volume_channels[0], -20.0)
    assert dac.volumes == before


@both
def test_a_device_that_is_louder_than_full_scale_at_its_lowest_is_not_touched(uac: int) -> None:
    control, _, _ = rig(uac, volume_range=(0x200, 0x600, 0x80))
    with pytest.raises(UsageError, match=r"volume of the device is \+2.00 dB, above the limit"):
        control.set_volume_db(control.volume_channels[0], -20.0)


@both
def test_a_volume_that_a_device_takes_and_ignores_is_told(uac: int) -> None:
    control, dac, _ = rig(uac, ignores=True)
    channel = control.volume_channels[0]
    with pytest.raises(UsbAccessError, match=r"takes -30 dB for channel 1 but then reports -8 dB"):
        control.set_volume_db(channel, -30.0)
    assert dac.volumes[channel] == -0x800
    assert control.set_volume_db(channel, -8.0) == -8.0


@both
def test_a_range_of_one_value_leaves_that_one(uac: int) -> None:
    control, _, _ = rig(uac, volume_range=(-0x1400, -0x1400, 0))
    channel = control.volume_channels[0]
    assert control.set_volume_db(channel, 0.0) == -20.0
    assert control.set_volume_db(channel, -30.0) == -20.0  # who asked sees that it is louder


@both
def test_a_range_that_is_wider_than_the_device_s_own_is_found_out(uac: int) -> None:
    control, dac, _ = rig(uac)
    channel = control.volume_channels[0]
    dac.real_range = (-0x1400, 0)
    with pytest.raises(UsbAccessError, match="takes -50 dB"):
        control.set_volume_db(channel, -50.0)


@both
def test_a_device_that_goes_between_set_and_read_back_was_pulled_out(uac: int) -> None:
    control, dac, _ = rig(uac)
    answers = dac.control

    def once(setup: bytes, data: bytes) -> bytes | None:
        if not setup[0] & 0x80:
            control._handle.error = errno.ENODEV
        return answers(setup, data)

    dac.control = once  # type: ignore[method-assign]
    with pytest.raises(NoUsbDeviceError, match="pulled out"):
        control.set_volume_db(control.volume_channels[0], -30.0)


@both
def test_mute_and_rate_are_read_and_set(uac: int) -> None:
    control, dac, _ = rig(uac)
    for channel in control.mute_channels:
        assert not control.muted(channel)
        control.set_muted(channel, True)
        assert control.muted(channel)
        assert dac.mutes[channel] == 1
    assert control.samplerate() == 44_100
    control.set_samplerate(48_000)
    assert dac.samplerate == control.samplerate() == 48_000
    with pytest.raises(UsbAccessError, match="it stalls"):
        control.set_samplerate(12_345)
    with pytest.raises(UsageError, match="not possible"):
        control.set_samplerate(0)


def test_the_clock_of_2_0_says_what_it_offers() -> None:
    control, _, _ = rig(2)
    assert control.samplerates() == (RateRange(44_100, 44_100), RateRange(48_000, 48_000))


def test_of_several_clocks_none_is_asked() -> None:
    playback = playback_formats(parse_configuration(async_dac()))[0]
    dac = SoftwareDac(b"", 2, [])
    with pytest.raises(UsbAccessError, match="the clock in use is not known"):
        UsbControl(a_device(2), playback, Wire(dac)).samplerate()
    assert dac.log == []


@both
def test_what_was_set_is_set_back_but_never_too_loud_again(uac: int) -> None:
    control, dac, _ = rig(uac, volume_range=(-0x4000, 0x600, 0x80))
    channel = control.volume_channels[0]
    dac.volumes[channel] = 0x400
    before = control.state()
    control.set_volume_db(channel, -30.0)
    for muted in control.mute_channels:
        control.set_muted(muted, True)
    control.set_samplerate(48_000)
    control.restore(before)
    assert dac.volumes[channel] == 0  # +4 dB it was
    assert not any(dac.mutes.values())
    assert dac.samplerate == 44_100


@both
def test_a_device_that_stalls_every_request_is_no_more_than_an_error_each(uac: int) -> None:
    control, dac, _ = rig(uac, stalls=True)
    channel = control.volume_channels[0]
    for ask in (
        lambda: control.volume_db(channel),
        lambda: control.volume_range(channel),
        lambda: control.set_volume_db(channel, -10.0),
        control.samplerate,
    ):
        with pytest.raises(UsbAccessError, match="refuses the request"):
            ask()
    assert control.state() == ControlState()
    control.restore(control.state())
    assert dac.log


@both
@pytest.mark.parametrize(
    ("number", "kind", "says"),
    [
        (errno.ENODEV, NoUsbDeviceError, "pulled out"),
        (errno.EACCES, UsbAccessError, "no permission"),
        (errno.EBUSY, UsbAccessError, "held by a driver"),
        (errno.ETIMEDOUT, UsbAccessError, "does not answer within 500 ms"),
        (errno.EIO, UsbAccessError, "does not answer correctly"),
    ],
)
def test_every_refusal_has_its_own_words(
    uac: int, number: int, kind: type[Exception], says: str
) -> None:
    control, _, playback = rig(uac)
    refused = UsbControl(a_device(uac), playback, Wire(SoftwareDac(b"", uac, []), error=number))
    with pytest.raises(kind, match=says):
        refused.volume_db(control.volume_channels[0])


@given(st.binary(max_size=64), st.integers(0, 5))
def test_answers_of_any_bytes_are_a_value_or_an_error_of_the_device(raw: bytes, which: int) -> None:
    read: list[Any] = [
        requests.volume,
        requests.volume_ranges,
        requests.samplerate_ranges,
        lambda answer: requests.number(answer, 4),
        lambda answer: requests.volume_range(answer, answer, answer),
        lambda answer: requests.volume_range(answer[:2], answer[2:4], answer[4:]),
    ]
    with suppress(UsbAccessError):
        read[which](raw)
