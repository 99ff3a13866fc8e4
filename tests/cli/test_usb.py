import json
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest

from audioflinger_hook.cli import devices, test_tone, usb
from audioflinger_hook.cli.outputs import list_outputs
from audioflinger_hook.cli.usb import mixer_lines, mixer_of, volume_now
from audioflinger_hook.cli.usb_formats import by_setting, format_text, formats_of
from audioflinger_hook.daemon.outputs.base import DeviceVolume
from audioflinger_hook.daemon.outputs.sink import SinkOutput
from device.errors import LostError
from device.server import ServerSnapshot
from device.server.snapshot import Sink
from device.usb import UsbAudioDevice, find_devices
from device.usb.descriptors import RateRange, parse_configuration
from tests.support import usb_builder
from tests.support.commands import DEADLINE_S, Done, call, refused, start
from tests.support.data import table
from tests.support.snapshots import snapshot, stream
from tests.support.sound_cards import ADAPTIVE, ASYNC, Cards
from tests.support.usb_shapes import SHAPES, headset_adapter
from tests.support.usb_tree import UsbTree

DEVICE = usb_builder.device(product=0xDAC1)
KEYS = table("usb-keys.toml")


@pytest.fixture
def describe(tmp_path: Path) -> Callable[..., Done]:

    def run(shown: bytes | str, *options: str) -> Done:
        path = tmp_path / "dac.hex"
        path.write_text(shown if isinstance(shown, str) else xxd(shown))
        done = call("usb", "describe", *options, "--hex", path)
        assert done.code == (2 if done.stderr else 0), done
        return done

    return run


def xxd(raw: bytes) -> str:
    rows = ((at, raw[at : at + 16].hex(" ", 2)) for at in range(0, len(raw), 16))
    return "".join(f"{at:08x}: {row}  ................\n" for at, row in rows)


def test_a_dump_is_told_in_words(describe: Callable[..., Done]) -> None:
    done = describe(DEVICE + headset_adapter())
    assert (done.code, done.stderr) == (0, "")
    assert "1209:dac1" in done.stdout
    assert "plays: interface 1.1, PCM of 16 bits in 2 bytes, 2 channels, 44100, 48000 Hz" in (
        done.stdout.replace("48000, 44100", "44100, 48000")
    )
    assert "plays: nothing" not in done.stdout


def test_the_document_keeps_its_keys_also_without_a_device(describe: Callable[..., Done]) -> None:
    document = json.loads(describe(DEVICE + headset_adapter(), "--json").stdout)
    (configuration,) = document["configurations"]
    parts = {"": document, "device": document["device"], "configurations": configuration}
    parts |= {key: configuration[key][0] for key in ("formats", "playback")}
    assert {key: sorted(part) for key, part in parts.items()} == KEYS
    document = json.loads(describe(headset_adapter(), "--json").stdout)
    assert document["device"] is document["settings"] is None
    assert document["configurations"][0]["bytes"] == headset_adapter().hex()


def test_unknown_bytes_are_kept(describe: Callable[..., Done]) -> None:
    odd = bytes([5, 0xF7, 1, 2, 3])
    configuration = usb_builder.configuration(headset_adapter()[9:] + odd) + b"\x09\xab"
    document = json.loads(describe(DEVICE + configuration, "--json").stdout)
    kept = "".join(each["bytes"] for each in document["configurations"]) + document["rest"]
    assert (kept, document["bytes"]) == (configuration.hex(), (DEVICE + configuration).hex())


def test_a_damaged_dump_says_what_is_lost_and_what_plays(describe: Callable[..., Done]) -> None:
    done = describe((DEVICE + headset_adapter())[:-40])
    assert (done.code, done.stderr) == (0, "")
    lines, size = done.stdout.splitlines(), len(headset_adapter())
    lost = f"it has {size - 40} bytes, but wTotalLength is {size}: 40 missing"
    assert f"problem: at 0x0012, configuration: {lost}" in lines
    assert any(line.startswith("plays: interface 1.1, PCM of 16 bits") for line in lines)
    assert "volume can be set on channels 1, 2" in lines
    assert describe(done.stdout).stdout == done.stdout  # what is printed can be read again
    silent = usb_builder.configuration(usb_builder.control(0, 0, usb_builder.header_1([])))
    assert "plays: nothing" in describe(DEVICE + silent).stdout
    lost = "0 of 1 configuration can be read; from 0x0012 on, 2 bytes cannot be read"
    assert f"problem: {lost}" in describe(DEVICE + b"\x09\x04").stdout


def test_a_dump_comes_from_standard_input_too() -> None:
    options = ("usb", "describe", "--json", "--hex", "-")
    with start(*options, stdin=subprocess.PIPE) as process:
        stdout, _ = process.communicate(xxd(DEVICE + headset_adapter()), DEADLINE_S)
    assert process.returncode == 0
    assert json.loads(stdout)["configurations"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "hex dump: it has no bytes"),
        ("what is this\n", "line 1"),
        ("00000000: 1201 0002\n00000020: 0000 0040\n", "address is 0x20 instead of 0x4"),
        ("00 " * (2 << 20), "too long for descriptors"),
    ],
)
def test_what_is_no_dump_is_refused(describe: Callable[..., Done], text: str, words: str) -> None:
    assert words in refused(describe(text))


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "none"
    assert f"cannot read {path}" in refused(call("usb", "describe", "--hex", path))


@pytest.mark.parametrize("more", ["usb:1209:dac1", "--take-over"])
def test_a_dump_goes_with_no_device(describe: Callable[..., Done], more: str) -> None:
    assert "leave out DEVICE and --take-over" in refused(describe(DEVICE, more))


@pytest.mark.parametrize("name", ["usb:", "usb:12", "usb:zzzz:0001", "sink:haptic"])
def test_a_name_that_is_none_is_refused(name: str) -> None:
    done = call("usb", "describe", name)
    assert done.code in (2, 3)
    refused(done, done.code)


SILENT = {"name": "PCM Playback Volume", "db": [None, None], "lowest_db": None, "highest_db": 0.0}
SOFT = {**SILENT, "db": [-30.0, -12.5]}
NO_TABLE = {"name": "PCM Playback Volume"}
MUTED = {"name": "PCM Playback Switch", "muted": [True, True]}
HALF = {"name": "PCM Playback Switch", "muted": [True, False]}


@pytest.mark.parametrize(
    ("volumes", "mutes", "word"),
    [
        *(([SOFT], [], "-12.5 dB"), ([SOFT], [HALF], "-12.5 dB"), ([SOFT], [MUTED], "muted")),
        *(([SILENT], [], "silence"), ([NO_TABLE], [HALF], ""), ([], [], "")),
    ],
)
def test_the_loudest_channel_counts_and_a_mute_of_all_before_it(volumes, mutes, word):
    assert volume_now({"volumes": volumes, "mutes": mutes, "problem": None}) == word


def test_every_control_has_a_line_of_its_own_and_one_says_why_none_could_be_read() -> None:
    mixer = {"volumes": [SOFT, NO_TABLE], "mutes": [MUTED, HALF], "problem": None}
    assert mixer_lines(mixer) == [
        "PCM Playback Volume of the sound card: -30.00 dB, -12.50 dB, silence to +0.00 dB",
        "PCM Playback Volume of the sound card: in steps of unknown size",
        "PCM Playback Switch of the sound card: muted",
        "PCM Playback Switch of the sound card: partly muted",
    ]
    mixer = {"volumes": [], "mutes": [], "problem": "this user may not open it"}
    assert mixer_lines(mixer) == ["volume of the sound card unknown: this user may not open it"]


def test_of_mutes_that_cannot_all_be_read_none_is_told(device, monkeypatch):
    mixer = Mock(volumes=[], switches=[Mock()] * 2)
    mixer.muted.side_effect = [(True,), LostError("gone")]
    monkeypatch.setattr(usb, "CardMixer", lambda number: mixer)
    assert mixer_of(device) == {"volumes": [], "mutes": [], "problem": "gone"}


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
MUTED_SINK = replace(DAC, volume_db=-31.4, mute=True)


def seen(sink: Sink, default: str = "speakers") -> ServerSnapshot:
    return snapshot(default_sink=default, sinks=(sink,))


@pytest.mark.parametrize(
    ("sink", "weakened"),
    [(DAC, ""), (replace(DAC, volume_db=4.0), ""), (DOWN, "volume 30 %"), (MUTED_SINK, "muted")],
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
    (silent,) = test_tone._warnings(MUTED_SINK, seen(MUTED_SINK))
    assert "`pactl set-sink-mute dac 0`" in silent
    (heard,) = test_tone._warnings(DAC, seen(DAC, default="dac"))
    assert "the default output" in heard
    (output,) = list_outputs(seen(MUTED_SINK), (), ())
    assert "now muted" in output.note


@pytest.mark.parametrize(("sink", "warns"), [(MUTED_SINK, True), (DOWN, False), (None, False)])
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
