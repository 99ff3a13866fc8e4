"""`cushion usb describe` of dumps: what it says, what it keeps, what it refuses."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import usb_builder
from tests.support.commands import call
from tests.support.recordings import ROOT
from tests.support.usb_shapes import headset_adapter

DEVICE = usb_builder.device(product=0xDAC1)


def dump(path: Path, raw: bytes) -> Path:
    """As xxd shows it."""
    lines = [
        f"{at:08x}: {raw[at : at + 16].hex(' ', 2)}  ................"
        for at in range(0, len(raw), 16)
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_dump_is_told_in_words(tmp_path: Path) -> None:
    done = call("usb", "describe", "--hex", dump(tmp_path / "dac.hex", DEVICE + headset_adapter()))
    assert (done.code, done.stderr) == (0, "")
    assert "1209:dac1" in done.stdout
    assert "plays: interface 1.1, PCM of 16 bits in 2 bytes, 2 channels, 44100, 48000 Hz" in (
        done.stdout.replace("48000, 44100", "44100, 48000")
    )


def test_a_dump_of_the_configuration_alone_is_enough(tmp_path: Path) -> None:
    done = call("usb", "describe", "--json", "--hex", dump(tmp_path / "dac", headset_adapter()))
    document = json.loads(done.stdout)
    assert done.code == 0
    assert document["device"] is None
    assert document["configurations"][0]["bytes"] == headset_adapter().hex()
    assert document["settings"] is None


def test_unknown_bytes_are_kept(tmp_path: Path) -> None:
    odd = bytes([5, 0xF7, 1, 2, 3])
    configuration = usb_builder.configuration(headset_adapter()[9:] + odd)
    raw = DEVICE + configuration + b"\x09\xab"
    done = call("usb", "describe", "--json", "--hex", dump(tmp_path / "dac.hex", raw))
    document = json.loads(done.stdout)
    assert done.code == 0
    kept = "".join(each["bytes"] for each in document["configurations"]) + document["rest"]
    assert kept == (configuration + b"\x09\xab").hex()
    assert document["bytes"] == raw.hex()


def test_a_damaged_dump_says_in_words_what_is_lost_and_shows_the_rest(tmp_path: Path) -> None:
    raw = DEVICE + headset_adapter()
    done = call("usb", "describe", "--hex", dump(tmp_path / "dac.hex", raw[:-40]))
    assert (done.code, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    size = len(headset_adapter())
    assert (
        f"problem: at 0x0012, configuration: it has {size - 40} bytes, but wTotalLength is {size}: "
        "40 missing"
    ) in lines
    assert any(line.startswith("plays: interface 1.1, PCM of 16 bits") for line in lines)
    assert "volume can be set on channels 1, 2" in lines
    # What is printed can be read again.
    again = tmp_path / "again"
    again.write_text(done.stdout)
    assert call("usb", "describe", "--hex", again).stdout == done.stdout


def test_a_dump_that_plays_nothing_says_so(tmp_path: Path) -> None:
    silent = usb_builder.configuration(usb_builder.control(0, 0, usb_builder.header_1([])))
    done = call("usb", "describe", "--hex", dump(tmp_path / "dac.hex", DEVICE + silent))
    assert "plays: nothing" in done.stdout
    done = call("usb", "describe", "--hex", dump(tmp_path / "dac.hex", DEVICE + b"\x09\x04"))
    lost = "0 of 1 configuration can be read; from 0x0012 on, 2 bytes cannot be read"
    assert f"problem: {lost}" in done.stdout


def test_a_dump_comes_from_standard_input_too(tmp_path: Path) -> None:
    path = dump(tmp_path / "dac.hex", DEVICE + headset_adapter())
    done = subprocess.run(
        [sys.executable, "-m", "audioflinger_hook", "usb", "describe", "--json", "--hex", "-"],
        input=path.read_bytes(),
        capture_output=True,
        cwd=ROOT,
    )
    assert done.returncode == 0
    assert json.loads(done.stdout)["configurations"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "it has no bytes"),
        ("what is this\n", "line 1"),
        ("00000000: 1201 0002\n00000020: 0000 0040\n", "address is 0x20 instead of 0x4"),
    ],
)
def test_what_is_no_dump_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "dac.hex"
    path.write_text(text)
    done = call("usb", "describe", "--hex", path)
    assert (done.code, done.stdout) == (2, "")
    assert done.stderr.startswith("cushion: error: hex dump")
    assert words in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_file_that_is_not_there_or_too_long_is_refused(tmp_path: Path) -> None:
    done = call("usb", "describe", "--hex", tmp_path / "none")
    assert done.code == 2
    assert f"cannot read {tmp_path / 'none'}" in done.stderr
    large = tmp_path / "large"
    large.write_bytes(b"00 " * (2 << 20))
    done = call("usb", "describe", "--hex", large)
    assert done.code == 2
    assert "no dump of descriptors" in done.stderr


def test_a_dump_goes_with_no_device(tmp_path: Path) -> None:
    path = dump(tmp_path / "dac.hex", DEVICE)
    for more in (["usb:1209:dac1"], ["--take-over"]):
        done = call("usb", "describe", *more, "--hex", path)
        assert done.code == 2
        assert "goes with neither" in done.stderr


@pytest.mark.parametrize("name", ["usb:", "usb:12", "usb:zzzz:0001", "sink:haptic"])
def test_a_name_that_is_none_is_refused(name: str) -> None:
    done = call("usb", "describe", name)
    assert done.code in (2, 3)
    assert done.stderr.startswith("cushion: error: ")
    assert done.stderr.count("\n") == 1
