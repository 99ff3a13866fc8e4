"""What `cushion devices` takes from the driver where descriptors do not tell."""

import shutil
from pathlib import Path

import pytest

from audioflinger_hook.cli.devices import _server
from audioflinger_hook.cli.usb_formats import by_setting, format_text, formats_of
from device.usb import UsbAudioDevice, find_devices
from device.usb.descriptors import RateRange, parse_configuration
from tests.support import usb_builder
from tests.support.snapshots import snapshot, stream
from tests.support.sound_cards import ADAPTIVE, ASYNC, Cards
from tests.support.usb_shapes import SHAPES
from tests.support.usb_tree import UsbTree


@pytest.fixture
def device(tmp_path: Path) -> UsbAudioDevice:
    UsbTree(tmp_path / "machine").plug(card=1)
    (found,) = find_devices(tmp_path / "machine").devices
    return found


def test_what_plays_is_applications_alone() -> None:
    own = {"application.id": "haptic-cushion"}
    streams = (
        stream(1, properties={"node.link-group": "filter-chain-812-7"}),  # the native engine
        stream(2, properties={"pulse.module.id": "9"}),  # drop-in mode
        stream(3, application="Haptic Cushion", properties=own),
        stream(4, application="mpv"),
    )
    found = _server(snapshot(sink_inputs=streams))
    assert [application["name"] for application in found["applications"]] == ["mpv"]


def test_rates_of_each_setting_are_those_that_the_driver_offers_of_this_device(device, tmp_path):
    cards = Cards(tmp_path / "asound")
    assert by_setting(device, tmp_path / "asound") == {}
    cards.plug(2, "Other", stream=ADAPTIVE)
    assert by_setting(device, tmp_path / "asound") == {}
    cards.plug(1, "DAC", stream=ASYNC)
    offered = by_setting(device, tmp_path / "asound")
    assert sorted(offered) == [(1, 1), (1, 2), (1, 3)]
    assert 192_000 in offered[1, 2].rates
    assert 192_000 not in offered[1, 3].rates
    shutil.rmtree(tmp_path / "asound")
    assert by_setting(device, tmp_path / "asound") == {}


CLASS_3 = ASYNC.replace("Altset 1", "Altset 7", 1)
"""The driver lists settings 2, 3 and 7 of interface 1."""


@pytest.fixture
def cards(tmp_path: Path) -> Path:
    Cards(tmp_path / "asound").plug(1, "DAC", stream=CLASS_3)
    return tmp_path / "asound"


def test_the_driver_tells_what_class_3_leaves_open(device: UsbAudioDevice, cards: Path) -> None:
    play = usb_builder.class_specific(1, bytes([5, *bytes(4), 2, 0, 1, *bytes(7), 4, 24, 0, 0, 4]))
    data = usb_builder.endpoint(1, usb_builder.ISOCHRONOUS | usb_builder.ASYNCHRONOUS, 192)
    configuration = parse_configuration(
        usb_builder.configuration(
            usb_builder.association(0, 2, usb_builder.UAC3),
            usb_builder.control(0, usb_builder.UAC3),
            usb_builder.streaming(1, 0, usb_builder.UAC3),
            usb_builder.streaming(1, 2, usb_builder.UAC3, play, data),
        )
    )
    decoded, *listed = formats_of(configuration, device, root=cards)
    assert (decoded["audio_class"], decoded["encodings"], decoded["bits"]) == (3, ["PCM"], 24)
    assert decoded["channels"] == 2
    assert decoded["samplerates"] == [44_100, 48_000, 88_200, 96_000, 176_400, 192_000]
    assert [(each["alternate"], each["audio_class"]) for each in listed] == [(7, 3), (3, 3)]
    assert (listed[0]["encodings"], listed[1]["encodings"]) == (["S16_LE"], ["DSD"])
    (alone,) = formats_of(configuration)
    assert (alone["channels"], alone["samplerates"]) == (0, None)


def test_native_dsd_is_not_called_samples_of_32_bits(device: UsbAudioDevice, cards: Path) -> None:
    pcm, _, dsd = map(format_text, formats_of(parse_configuration(SHAPES["async_dac"])))
    assert dsd == "native DSD, 2 channels, unknown samplerates, asynchronous, feedback"
    assert pcm.startswith("PCM of 24 bits in 4 bytes, 2 channels")
    # A device that calls it PCM is known to the driver.
    shape = SHAPES["async_dac"].replace(bytes([1, 0, 0, 0, 0x80, 2]), bytes([1, 1, 0, 0, 0, 2]))
    plain = parse_configuration(shape)
    assert format_text(formats_of(plain)[2]).startswith("PCM of 32 bits")
    of_driver = formats_of(plain, device, root=cards)[2]
    assert format_text(of_driver).startswith("native DSD, 2 channels, 44100, 48000 Hz")


def test_rates_that_a_clock_was_asked_for_are_those_of_its_formats() -> None:
    configuration = parse_configuration(SHAPES["async_dac"])
    single = [RateRange(44_100, 44_100), RateRange(96_000, 96_000)]
    assert formats_of(configuration, asked=single)[0]["samplerates"] == [44_100, 96_000]
    some = [RateRange(44_100, 44_100), RateRange(48_000, 96_000)]
    found = formats_of(configuration, asked=some)[0]
    assert found["samplerates"] == {"lowest": 44_100, "highest": 96_000}
    assert ", 44.1 to 96 kHz, " in format_text(found, units="kHz")
