"""The wheel alone, in an environment without PortAudio, pulsectl, PyUSB and the page's packages."""

import importlib.util
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from tests.support.commands import noise, sound, vibration
from tests.support.recordings import ROOT

NEEDED = ["numpy", "scipy", "soundfile", "_soundfile_data", "_soundfile", "cffi", "_cffi_backend"]
NEEDED += ["pycparser", "rich", "markdown_it", "mdurl", "pygments", "tomlkit", "typing_extensions"]
"""The modules of the dependencies, and of what these depend on themselves."""

pytestmark = pytest.mark.exhaustive


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("wheel")


@lru_cache(maxsize=2)
def wheel_by_zig(folder: Path, machine: str) -> Path:
    """Return the path of the wheel for a kind of processor, as `make wheels` builds it."""
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("the package ziglang is not installed")
    copy = folder / machine
    for name in ("audioflinger_hook", "device", "share", "tools"):
        ignored = shutil.ignore_patterns("__pycache__", "*.so")
        shutil.copytree(ROOT / name, copy / name, ignore=ignored)
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE", "constraints.txt"):
        shutil.copy(ROOT / name, copy)
    (copy / ".venv").symlink_to(sys.prefix)
    subprocess.run([copy / "tools/wheels.sh", machine], check=True, stdout=subprocess.DEVNULL)
    (built,) = (copy / "dist").glob("*.whl")
    return built


@pytest.fixture(scope="module")
def environment(folder: Path) -> Path:
    """The programs' folder of an environment with the wheel and its dependencies, and no more."""
    built = wheel_by_zig(folder, platform.machine())
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "venv"], check=True)
    python = folder / "venv/bin/python"
    subprocess.run([*pip, "--python", python, "install", "--no-deps", built], check=True)
    site = Path(sysconfig.get_path("purelib"))
    (target,) = (folder / "venv/lib").glob("python*/site-packages")
    for module in site.iterdir():
        if module.name.split(".")[0] in NEEDED and module.name.split(".")[-1] != "dist-info":
            (target / module.name).symlink_to(module)
    return folder / "venv/bin"


def run(environment: Path, *command: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    plain = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    program, *arguments = map(str, command)
    return subprocess.run(
        [environment / program, *arguments], cwd=cwd, env=plain, capture_output=True, text=True
    )


@pytest.mark.parametrize("module", ["pyaudio", "pulsectl", "usb", "websockets", "matplotlib"])
def test_the_environment_lacks_the_extras(environment: Path, tmp_path: Path, module: str) -> None:
    assert run(environment, "python", "-c", f"import {module}", cwd=tmp_path).returncode == 1


@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
def test_one_wheel_serves_every_python_and_each_glibc_it_names(folder: Path, machine: str) -> None:
    built = wheel_by_zig(folder, machine)
    assert built.name.endswith(f"-py3-none-manylinux_2_28_{machine}.whl")
    with zipfile.ZipFile(built) as archive:
        libraries = [archive.read(name) for name in archive.namelist() if name.endswith(".so")]
    assert len(libraries) == 2
    for library in libraries:
        wanted = re.findall(rb"GLIBC_(\d+)\.(\d+)", library)
        assert wanted
        assert max((int(major), int(minor)) for major, minor in wanted) <= (2, 28)
        assert b"libpython" not in library


def test_it_renders_as_the_full_environment_does(environment: Path, tmp_path: Path) -> None:
    sound(tmp_path / "in.wav", noise(24_000, 2))
    done = run(environment, "cushion", "render", "in.wav", "out.wav", "--json", cwd=tmp_path)
    assert (done.returncode, done.stderr, json.loads(done.stdout)["frames"]) == (0, "", 24_000)
    assert np.abs(vibration(tmp_path / "out.wav")).max() > 0.01


def test_the_demo_plays_the_same_without_a_compiler(environment: Path, tmp_path: Path) -> None:
    alone = {"PATH": str(environment), "HOME": str(tmp_path)}  # no program but the wheel's
    demo = ["-m", "audioflinger_hook", "demo", "--fast", "--out"]
    done, here = (
        subprocess.run(
            [python, *demo, tmp_path / out], cwd=cwd, env=alone, capture_output=True, text=True
        )
        for python, out, cwd in (
            (environment / "python", "wheel", tmp_path),
            (sys.executable, "here", ROOT),
        )
    )
    assert (done.returncode, here.returncode) == (0, 0), done.stderr
    assert done.stderr.count("\n") == 1
    assert "matplotlib is not installed" in done.stderr
    vibrations = [(tmp_path / out / "vibration.wav").read_bytes() for out in ("wheel", "here")]
    assert vibrations[0] == vibrations[1]


@pytest.mark.parametrize(
    ("command", "package", "extra"),
    [
        (["test-tone", "--device", "haptic"], "pulsectl", "live"),
        (["setup", "--yes", "--device", "haptic"], "pulsectl", "live"),
        (["run", "--device", "haptic"], "pulsectl", "live"),
        (["monitor"], "prometheus_client", "page"),
    ],
)
def test_a_command_that_needs_an_extra_names_it_in_one_line(
    environment: Path, tmp_path: Path, command: list[str], package: str, extra: str
) -> None:
    done = run(environment, "cushion", *command, cwd=tmp_path)
    assert done.returncode in (2, 3)
    assert done.stderr.splitlines()[-1] == (
        f'cushion: error: {package} is not installed; install it: pip install "haptic-cushion'
        f'[{extra}]"'
    )
