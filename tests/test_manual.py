import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from audioflinger_hook import __version__
from tools import manual

FILES = manual.files()
MAN, BASH, ZSH, FISH = FILES
PROJECT = tomllib.loads((manual.SHARE.parent / "pyproject.toml").read_text())


@pytest.mark.parametrize("name", FILES, ids=str)
def test_a_file_is_what_the_parser_makes_of_it(name: Path) -> None:
    text = (manual.SHARE / name).read_text()
    assert text == FILES[name], "run: python -m tools.manual --write"


@pytest.mark.parametrize("command", manual.commands(), ids=lambda command: command.name)
def test_each_file_names_the_command_and_each_of_its_options(command: manual.Command) -> None:
    page = FILES[MAN].partition(f"\n.SS cushion {command.name.replace('-', chr(92) + '-')}\n")[2]
    section = page.partition("\n.SS ")[0]
    (line,) = [line for line in FILES[BASH].splitlines() if f" {command.name}) words=" in line]
    arguments = FILES[ZSH].partition(f"\n        {command.name})\n")[2].partition(";;")[0]
    lines = [line for line in FILES[FISH].splitlines() if f"from {command.name}'" in line]
    assert len(command.flags) > 1
    for flag in command.flags:
        assert f"\\fB{flag.replace('-', chr(92) + '-')}\\fR" in section
        assert flag in line.replace('"', " ").split()
        assert f"'{flag}[" in arguments
        assert any(f" -{'l' if flag[1] == '-' else 's'} {flag.lstrip('-')} " in o for o in lines)


def test_the_wheel_installs_each_file() -> None:
    installed = PROJECT["tool"]["setuptools"]["data-files"]
    menu = {"applications/haptic-cushion.desktop", "icons/hicolor/scalable/apps/haptic-cushion.svg"}
    assert {(folder, path) for folder, paths in installed.items() for path in paths} == {
        (f"share/{name.parent}", f"share/{name}") for name in [*FILES, *map(Path, menu)]
    }


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["cushion", "set"], ["setup"]),
        (["cushion", "setup", "--no"], ["--no-test", "--no-service"]),
        (["cushion", "run", "--profile", "c"], ["cinema"]),
        (["cushion", "usb", "des"], ["describe"]),
    ],
)
def test_bash_offers_what_fits(words: list[str], offered: list[str]) -> None:
    script = (
        f'source "{manual.SHARE / BASH}"; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _cushion; '
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    command = ["bash", "-c", script, "bash", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (done.stdout.split(), done.stderr) == (offered, "")


@pytest.mark.parametrize(
    ("program", "check", "name"),
    [("zsh", ["-n"], ZSH), ("fish", ["--no-execute"], FISH), ("bash", ["-n"], BASH)],
)
def test_a_completion_parses(program: str, check: list[str], name: Path) -> None:
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not here")
    done = subprocess.run([program, *check, manual.SHARE / name], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_manual_page_is_formatted_without_a_warning() -> None:
    if shutil.which("groff") is None:
        pytest.skip("groff is not here")
    command = ["groff", "-man", "-Tutf8", "-ww", "-z", str(manual.SHARE / MAN)]
    assert subprocess.run(command, capture_output=True, text=True).stderr == ""


def test_the_debian_package_has_this_version_and_these_dependencies() -> None:
    debian = manual.SHARE.parent / "debian"
    assert (debian / "changelog").read_text().startswith(f"haptic-cushion ({__version__}) ")
    control = (debian / "control").read_text()
    depends, _, recommends = control.partition("\nDepends:")[2].partition("\nRecommends:")
    project = PROJECT["project"]
    extras = project["optional-dependencies"]
    for wanted, place in (
        (project["dependencies"], depends),
        (extras["live"] + extras["page"], recommends),
    ):
        for requirement in wanted:
            name = requirement.partition(">")[0].removeprefix("py").removesuffix("-client")
            name = {"audio": "pyaudio"}.get(name, name)
            assert f"python3-{name}" in place
