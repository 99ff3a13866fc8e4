"""Programs and examples that the documentation shows run, and show what they should."""

from __future__ import annotations

import doctest
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
SHOWN = {
    "block_by_block": ([], r"48000 frames of sound, 48000 of vibration\nlatency 7\.3 ms"),
    "compare_profiles": ([], r"paper +-\d.*\ncinema .*\ngame .*\nmusic "),
    "export_formats": (
        ["sound.wav", "exports"],
        r"(?s)sound\.ahap: .*sound\.haptic: .*sound\.hjif: ",
    ),
    "file_to_vibration": (["sound.wav", "out.wav"], r"out\.wav: 1\.0 s, peak 0\.\d"),
    "own_effect": ([], r"sound 0\.20, vibration 0\.(19|2\d)"),
    "principal_frequencies": ([], r"(?s)220\.\d Hz.* 277\.\d Hz.* 329\.\d Hz"),
    "replay_capture": (["folder", "out.wav"], r"the same bits: True\nout\.wav: 48000 frames"),
    "several_actuators": (
        ["sound.wav", "out.wav"],
        r"channel 2: peak 0\.00\nchannel 3: peak 0\.\d",
    ),
    "simulated_rig": ([], r"(?s)paper, 20 Hz: .*consumer, 160 Hz: \d"),
}
LINES_MAX = 40  # a program that fits on a screen


def test_every_program_of_the_examples_is_tested_and_in_the_table_of_the_page() -> None:
    programs = {path.stem for path in EXAMPLES.glob("*.py")}
    assert programs == set(SHOWN)
    page = (ROOT / "docs/examples.md").read_text()
    assert programs == set(re.findall(r"^\| `(\w+)\.py", page, re.MULTILINE))


@pytest.mark.parametrize("program", SHOWN)
def test_an_example_is_short_and_shows_what_it_should(program: str, tmp_path: Path) -> None:
    arguments, shown = SHOWN[program]
    time_s = np.arange(48_000) / 48_000
    soundfile.write(tmp_path / "sound.wav", 0.3 * np.sin(2 * np.pi * 300 * time_s), 48_000)
    path = EXAMPLES / f"{program}.py"
    ran = subprocess.run(
        [sys.executable, "-W", "error", str(path), *arguments],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    assert re.search(shown, ran.stdout), ran.stdout
    assert len(path.read_text().splitlines()) <= LINES_MAX


def test_the_examples_in_the_reference_give_what_stands_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs/api.md").read_text()
    examples = doctest.DocTestParser().get_doctest(page, {}, "api.md", "docs/api.md", 0)
    assert len(examples.examples) > 15
    assert doctest.DocTestRunner(verbose=False).run(examples).failed == 0


def test_the_first_example_for_developers_runs() -> None:
    page = (ROOT / "docs/get-started/developer.md").read_text()
    found = re.search(r"```python\n(.*?)```", page, re.DOTALL)
    assert found
    names: dict[str, object] = {}
    exec(found[1], names)
    vibration = names["vibration"]
    assert isinstance(vibration, np.ndarray)
    assert vibration.shape == (512, 1)
