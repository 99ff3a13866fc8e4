import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from audioflinger_hook.cli.usb import mixer_lines, volume_now
from tests.support import usb_builder
from tests.support.commands import DEADLINE_S, Done, call, refused, start
from tests.support.usb_shapes import headset_adapter

DEVICE = usb_builder.device(product=0xDAC1)


KEYS = {  # of the document, and of its parts
    "": "bytes configurations device problem rest settings",
    "device": "configurations product_id release usb vendor_id",
    "configurations": "active audio_class bytes formats playback problems value",
    "formats": "alternate audio_class bits channels encodings feedback implicit_feedback interface "
    "samplerates subslot_bytes synchronisation",
    "playback": "alternate bits channel_config channels clock_id clock_sources control_interface "
    "encodings endpoint_address feature_unit feedback_endpoint implicit_feedback interface "
    "interval mute_channels packet_bytes_max path samplerates subslot_bytes synchronisation uac "
    "volume_channels",
}


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
    assert {key: " ".join(sorted(part)) for key, part in parts.items()} == KEYS
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
