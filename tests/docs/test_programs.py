"""Programs and examples that the documentation shows run, and show what they should."""

import doctest
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.commands import RATE, sound
from tests.support.signals import tone

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
SHOWN = {
    "block_by_block": ("", r"48000 frames of sound, 48000 of vibration\nlatency 7\.3 ms"),
    "compare_profiles": ("", r"paper +-\d.*\ncinema .*\ngame .*\nmusic "),
    "export_formats": ("sound.wav exports", r"sound\.ahap: .*sound\.haptic: .*sound\.hjif: "),
    "file_to_vibration": ("sound.wav out.wav", r"out\.wav: 1\.0 s, peak 0\.\d"),
    "own_effect": ("", r"sound 0\.20, vibration 0\.(19|2\d)"),
    "principal_frequencies": ("", r"220\.\d Hz.* 277\.\d Hz.* 329\.\d Hz"),
    "replay_capture": ("folder out.wav", r"the same bits: True\nout\.wav: 48000 frames"),
    "several_actuators": ("sound.wav out.wav", r"channel 2: peak 0\.00\nchannel 3: peak 0\.\d"),
    "simulated_rig": ("", r"paper, 20 Hz: .*consumer, 160 Hz: \d"),
}


def test_every_program_of_the_examples_is_tested_and_in_the_table_of_the_page() -> None:
    programs = {path.stem for path in EXAMPLES.glob("*.py")}
    assert programs == set(SHOWN)
    page = (ROOT / "docs/examples.md").read_text()
    assert programs == set(re.findall(r"^\| `(\w+)\.py", page, re.MULTILINE))


@pytest.mark.parametrize("program", SHOWN)
def test_an_example_is_short_and_shows_what_it_should(program: str, tmp_path: Path) -> None:
    arguments, shown = SHOWN[program]
    sound(tmp_path / "sound.wav", tone(300.0, 1.0, RATE, 0.3))
    path = EXAMPLES / f"{program}.py"
    command = [sys.executable, "-W", "error", str(path), *arguments.split()]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert re.search(shown, ran.stdout, re.DOTALL), ran.stdout
    assert len(path.read_text().splitlines()) <= 40  # fits on a screen


def test_the_examples_in_the_reference_give_what_stands_there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs/api.md").read_text()
    examples = doctest.DocTestParser().get_doctest(page, {}, "api.md", "docs/api.md", 0)
    assert len(examples.examples) > 15
    assert doctest.DocTestRunner(verbose=False).run(examples).failed == 0


@pytest.mark.parametrize(
    ("page", "said", "shape"),
    [
        ("README.md", "7.3 ms late, peak 0.46\n", None),
        ("docs/get-started/developer.md", "", (512, 1)),
    ],
)
def test_the_first_example_of_a_page_runs(page, said, shape, capsys):
    found = re.search(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    assert found
    names: dict[str, Any] = {}
    exec(found[1], names)
    assert capsys.readouterr().out == said
    assert shape is None or names["vibration"].shape == shape
