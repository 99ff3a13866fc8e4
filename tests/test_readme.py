"""What README.md says is what happens."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import soundfile

from audioflinger_hook.cli.parser import build_parser
from audioflinger_hook.config import file as config
from audioflinger_hook.config.profiles import LIVE_DEFAULT
from audioflinger_hook.config.schema import ACTUATOR, KEYS
from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.transform import TransformParameters
from device.drive import ActuatorSettings
from device.drive.settings import DELAY_MAX_MS, GAIN_MIN_DB
from tests.support.parameters import CHOICES, LIMITS
from tools.readme_keys import with_table

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
ACTUATOR_KEYS = tuple(ActuatorSettings.DESCRIPTIONS)
OWN_EFFECT = "An effect of your own"


def block(language: str, section: str = "") -> str:
    """Return the first block of a language, after the heading of a section if one is named."""
    after = README[README.index(f"\n## {section}") :]
    found = re.search(rf"```{language}\n(.*?)```", after, re.DOTALL)
    assert found, f"README.md has no {language} block"
    return found[1]


def test_the_library_example_runs_and_says_what_it_should() -> None:
    ran = subprocess.run(
        [sys.executable, "-W", "error", "-c", block("python")],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    assert ran.stdout == "7.3 ms late, peak 0.46\n"


def test_the_config_example_is_valid_complete_and_the_default(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text(block("toml"))
    found, problems = config.check(path)
    assert problems == []
    assert found == config.Config(Settings(profile=LIVE_DEFAULT), LiveSettings(device="sink:NAME"))
    for key in KEYS:
        if key.section == ACTUATOR:
            continue
        # A key without a default stands there as a comment, and so may a profile's.
        comment = "(# )?" if key.owner is TransformParameters or key.default is None else ""
        shown = rf"^{comment}{key.name} = "
        assert re.search(shown, block("toml"), re.MULTILINE), f"{key.name} is missing"


def test_the_table_of_keys_is_that_of_the_schema() -> None:
    assert with_table(README) == README, "run `python -m tools.readme_keys --write`"
    for key in KEYS:
        assert f"\n| `{key.name}` |" in README


def test_the_example_of_several_actuators_is_valid_and_names_every_key(tmp_path: Path) -> None:
    after = README[README.index("\n### Several actuators") :]
    found = re.search(r"```toml\n(.*?)```", after, re.DOTALL)
    assert found
    path = tmp_path / "config.toml"
    path.write_text(found[1])
    done, problems = config.check(path)
    assert problems == []
    assert done is not None
    assert [actuator.source for actuator in done.settings.actuators] == ["left", "right"]
    told = {key for key in ACTUATOR_KEYS if re.search(rf"^{key} = ", found[1], re.MULTILINE)}
    assert told == {*ACTUATOR_KEYS} - {"damping"}  # named beside rig and protection
    for limit in (GAIN_MIN_DB, DELAY_MAX_MS):
        assert f"{limit:g}" in found[1]


def test_every_limit_in_the_config_example_is_the_real_one() -> None:
    for key, limits in LIMITS.items():
        assert f"{limits.low:g} to {limits.high:g}" in line_of(key)


def test_every_parameter_of_the_config_example_stands_there_with_its_default() -> None:
    for key in TransformParameters.DESCRIPTIONS:
        said = line_of(key).removeprefix("# ")
        assert tomllib.loads(said)[key] == getattr(TransformParameters(), key)


def test_every_choice_of_the_config_example_names_all_its_words() -> None:
    for key, choice in CHOICES.items():
        assert all(f'"{word}"' in line_of(key) for word in choice.words)


def line_of(key: str) -> str:
    """Return the line of the config example that a parameter stands on."""
    found = re.search(rf"^(# )?{key} = .*", block("toml"), re.MULTILINE)
    assert found, key
    return found[0]


def installed(folder: Path) -> Path:
    """Put the README's own effect where an installer would, and return that folder."""
    project = tomllib.loads(block("toml", OWN_EFFECT))["project"]
    (folder / "gentle.py").write_text(block("python", OWN_EFFECT))
    facts = folder / f"{project['name']}-{project['version']}.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    lines = []
    for group, entries in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())]
    (facts / "entry_points.txt").write_text("\n".join(lines))
    return folder


@pytest.mark.exhaustive
def test_the_effect_of_one_s_own_runs_before_the_haptic_effect_and_halves_it(
    tmp_path: Path,
) -> None:
    site = tmp_path / "site"
    site.mkdir()
    path = os.pathsep.join((str(installed(site)), str(ROOT)))
    (tmp_path / "audio_effects.xml").write_text(block("xml", OWN_EFFECT))
    chosen = re.findall(r"```toml\n(effects_file.*?)```", README, re.DOTALL)
    (tmp_path / "config.toml").write_text("".join(chosen))
    time_s = np.arange(48_000) / 48_000
    soundfile.write(tmp_path / "sound.wav", 0.4 * np.sin(2 * np.pi * 440 * time_s), 48_000)

    def cushion(*arguments: str) -> str:
        ran = subprocess.run(
            [sys.executable, "-m", "audioflinger_hook", *arguments],
            capture_output=True,
            text=True,
            check=True,
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": path},
        )
        assert ran.stderr == ""
        return ran.stdout

    dump = cushion("dump", "--tap", "scene:demo", "--config", "config.toml")
    assert re.findall(r"Effect \d: (.*)", dump) == ["Gentle", "Haptic Cushion"]
    cushion("render", "sound.wav", "plain.wav")
    cushion("render", "sound.wav", "halved.wav", "--config", "config.toml")
    plain, halved = (
        np.abs(soundfile.read(tmp_path / name)[0]).max() for name in ("plain.wav", "halved.wav")
    )
    assert halved == pytest.approx(plain / 2, rel=0.02)


def test_the_command_table_names_exactly_the_commands_that_exist() -> None:
    named = set(re.findall(r"^\| `cushion ([\w-]+)", README, re.MULTILINE))
    usage = build_parser().format_help()
    found = re.findall(r"^    ([\w-]+)(?: |$)", usage, re.MULTILINE)
    assert named == set(found)


@pytest.mark.parametrize("link", re.findall(r"\]\(([^)#]+)\)", README))
def test_every_link_leads_somewhere(link: str) -> None:
    assert (ROOT / link).exists()


@pytest.mark.parametrize("page", ["architecture", "decisions", "transform", "benchmarks"])
def test_every_file_that_a_page_names_exists(page: str) -> None:
    files = [path.relative_to(ROOT).as_posix() for path in ROOT.glob("*/**/*.py")]
    named = re.findall(r"`([\w/]+/\w+\.py)`", (ROOT / "docs" / f"{page}.md").read_text())
    missing = [name for name in named if not any(f"/{file}".endswith(f"/{name}") for file in files)]
    assert not missing
