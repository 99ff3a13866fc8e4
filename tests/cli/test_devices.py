import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from audioflinger_hook.cli import devices, test_tone
from audioflinger_hook.cli.outputs import list_outputs
from audioflinger_hook.cli.usb_formats import by_setting, format_text, formats_of
from audioflinger_hook.daemon.outputs.base import DeviceVolume
from audioflinger_hook.daemon.outputs.sink import SinkOutput
from device.server import ServerSnapshot
from device.server.snapshot import Sink
from device.usb import UsbAudioDevice, find_devices
from device.usb.descriptors import RateRange, parse_configuration
from tests.support import usb_builder
from tests.support.commands import call, refused
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
    found = devices._server(snapshot(sink_inputs=streams))
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


DAC = Sink(2, "dac", "USB DAC", "dac.monitor", 48_000, 2, None, {})
DOWN = replace(DAC, volume_db=-31.4)
MUTED = replace(DAC, volume_db=-31.4, mute=True)


def seen(sink: Sink, default: str = "speakers") -> ServerSnapshot:
    return snapshot(default_sink=default, sinks=(sink,))


@pytest.mark.parametrize(
    ("sink", "weakened"),
    [(DAC, ""), (replace(DAC, volume_db=4.0), ""), (DOWN, "volume 30 %"), (MUTED, "muted")],
)
def test_devices_lists_what_makes_an_output_weak(sink, weakened, capsys):
    assert sink.weakened == weakened
    devices._show(devices._server(seen(sink)) | {"usb": [], "cards": []})
    line = capsys.readouterr().out.splitlines()[2].strip()
    assert line == ", ".join(filter(None, ("USB DAC, 48000 Hz, 2 channels", weakened)))


def test_a_test_tone_says_why_it_may_not_be_felt_and_setup_lists_a_muted_output_as_muted() -> None:
    assert not list(test_tone._warnings(DAC, seen(DAC)))
    (down,) = test_tone._warnings(DOWN, seen(DOWN))
    assert "dac has volume 30 %" in down
    (silent,) = test_tone._warnings(MUTED, seen(MUTED))
    assert "`pactl set-sink-mute dac 0`" in silent
    (heard,) = test_tone._warnings(DAC, seen(DAC, default="dac"))
    assert "the default output" in heard
    (output,) = list_outputs(seen(MUTED), (), ())
    assert "now muted" in output.note


@pytest.mark.parametrize(("sink", "warns"), [(MUTED, True), (DOWN, False), (None, False)])
def test_a_daemon_warns_while_its_device_is_muted(sink: Sink | None, warns: bool) -> None:
    output = object.__new__(SinkOutput)
    output._found = sink
    output.volume = DeviceVolume(None)
    assert any("is muted" in warning for warning in output.warnings) == warns


def test_the_shortest_test_tone_is_as_long_as_the_message_says():
    for seconds, words in (
        *(("0.19", "allowed: 0.2 to 60 s"), ("60.1", "allowed: 0.2 to 60 s")),
        *(("0.2", "cannot play a test tone"), ("60", "cannot play a test tone")),
    ):
        assert words in refused(call("test-tone", "--device", "hw:x", "--seconds", seconds))
