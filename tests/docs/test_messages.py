import re
from pathlib import Path

import pytest

from tests.support.commands import RATE, call, noise, sound
from tools.docs.errors import AREAS, VALUE

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/errors.md").read_text()
LINES = dict(re.findall(r'^\| <a id="([\w-]+)"></a>(.*) \| (?:\d|warning) \|$', PAGE, re.MULTILINE))

CALLS: dict[str, tuple[object, ...]] = {
    "a misspelt command": ("rnder",),
    "an unknown option": ("status", "--quick"),
    "no input": ("render",),
    "a missing file": ("render", "missing.wav", "out.wav"),
    "an output that is no WAV": ("render", "sound.wav", "out.mp3"),
    "the standard output": ("render", "sound.wav", "-"),
    "the same file": ("render", "sound.wav", "sound.wav"),
    "a file that is no sound": ("render", "text.txt", "out.wav"),
    "a time after the end": ("inspect", "sound.wav", "--at", "99"),
    "an unknown profile": ("render", "sound.wav", "out.wav", "--profile", "cinem"),
    "an unknown rig": ("render", "sound.wav", "out.wav", "--rig", "unknown"),
    "a missing config file": ("render", "sound.wav", "out.wav", "--config", "missing.toml"),
    "a folder that is no capture": ("replay", ".", "out.wav"),
    "an unknown speed": ("replay", ".", "out.wav", "--speed", "2"),
    "a tap without a name": ("run", "--device", "twin", "--tap", "file:"),
    "a wrong USB device": ("run", "--device", "usb:12"),
    "a folder that is not empty": ("capture", ".", "--tap", "scene:demo"),
    "no daemon": ("status",),
    "a level that is too high": ("test-tone", "--device", "sink:x", "--level", "2"),
    "a calibration without input": ("calibrate", "--device", "sink:x"),
    "too many workers": ("render", "sound.wav", "--out-dir", ".", "--workers", "9999"),
    "an address that is none": ("monitor", "--listen", "here"),
    "a rate out of range": ("monitor", "--rate", "0"),
    "nothing to set": ("usb", "set", "usb:1234:5678"),
}

TEXTS = [re.sub(r"\\([|*_])", r"\1", shown).replace("&lt;", "<") for shown in LINES.values()]
PATTERNS = [
    ".*".join(map(re.escape, text.split(VALUE)))
    for text in TEXTS
    if len(text.replace(VALUE, "").strip()) >= 12
]
"""Messages with any values; those of a few words alone, such as "… is …", fit too much."""


def test_anchors_are_unique_and_every_area_has_messages() -> None:
    assert len(re.findall(r'<a id="', PAGE)) == len(LINES) > 300
    assert re.findall(r"^## (.+)$", PAGE, re.MULTILINE) == list(AREAS)


@pytest.mark.parametrize("what", CALLS)
def test_what_a_wrong_command_says_is_on_the_page(what, tmp_path, monkeypatch):
    sound(tmp_path / "sound.wav", noise(RATE))
    (tmp_path / "text.txt").write_text("no sound")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    done = call(*CALLS[what])
    assert done.code in (2, 3, 4, 5)
    said = done.stderr.strip().splitlines()[-1].removeprefix("cushion: ").removeprefix("error: ")
    assert any(re.fullmatch(pattern, said, re.DOTALL) for pattern in PATTERNS), said
