"""What README.md says is what happens."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from audioflinger_hook import config
from audioflinger_hook.cli.parser import build_parser
from audioflinger_hook.settings import Settings
from audioflinger_hook.transform import LIMITS

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()


def block(language: str) -> str:
    found = re.search(rf"```{language}\n(.*?)```", README, re.DOTALL)
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
    assert ran.stdout == "41.2 ms late, peak 0.40\n"


def test_the_config_example_is_valid_complete_and_the_default(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text(block("toml"))
    settings, problems = config.check(path)
    assert problems == []
    assert settings == Settings()
    for key in (*config.TOP_LEVEL, *config.TRANSFORM_CHOICES, *LIMITS):
        assert re.search(rf"^{key} = ", block("toml"), re.MULTILINE), f"{key} is missing"


def test_every_limit_in_the_config_example_is_the_real_one() -> None:
    for key, limits in LIMITS.items():
        assert f"{limits.low:g} to {limits.high:g}" in next(
            line for line in block("toml").splitlines() if line.startswith(key)
        )


def test_the_command_table_names_exactly_the_commands_that_exist() -> None:
    named = set(re.findall(r"^\| `cushion (\w+)", README, re.MULTILINE))
    usage = build_parser().format_help()
    found = re.findall(r"^    (\w+) ", usage, re.MULTILINE)
    assert named == set(found)


@pytest.mark.parametrize("link", re.findall(r"\]\(([^)#]+)\)", README))
def test_every_link_leads_somewhere(link: str) -> None:
    assert (ROOT / link).exists()
