import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

import audioflinger_hook
from tests.support.recordings import ROOT, WHY_NONE, recordings

PACKAGES = ["audioflinger_hook", "device"]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
SCRIPTS = ["tools/setup.sh", "tools/fetch_recordings.sh", "tools/check_kernel.sh", ".ci/run"]
SCRIPTS += ["tools/fetch_servers.sh", "tools/fetch_usb_mock.sh", "tools/fetch_usb_vm.sh"]
SCRIPTS += ["tools/system_packages.sh", "tools/fetch_sounds.sh", "tools/fetch_browser.sh"]
SCRIPTS += ["tools/unpacked_files.sh", "tools/wheels.sh"]
SET_UP = ROOT / "tools/setup.sh"
FETCH = ROOT / "tools/fetch_recordings.sh"
FETCH_SOUNDS = ROOT / "tools/fetch_sounds.sh"
SOURCED = [ROOT / "tools/system_packages.sh", ROOT / "tools/unpacked_files.sh"]
SOUND_LIST = ROOT / "tools/bench/sounds/real_sounds.txt"
IN_CI = os.environ.get("CI") == "true"

# The programs, beside the shell's own, that the scripts may count on before anything is set up.
PROGRAMS = ["basename", "cat", "chmod", "cksum", "dirname", "find", "grep", "head", "ls", "mkdir"]
PROGRAMS += ["mktemp", "readlink", "rm", "sed", "sh", "sort", "tail", "tr"]


@pytest.fixture(scope="module")
def project_copy(tmp_path_factory):
    copy = tmp_path_factory.mktemp("wheel")
    for name in ["pyproject.toml", "setup.py", "README.md", "LICENSE"]:
        if (ROOT / name).exists():
            shutil.copy(ROOT / name, copy)
    for name in [*PACKAGES, "share", "tests", "tools"]:
        ignored = shutil.ignore_patterns("__pycache__", "*.so")
        shutil.copytree(ROOT / name, copy / name, ignore=ignored)
    (copy / "device/probe").mkdir()
    (copy / "device/probe/probe.toml").write_text("")
    (copy / "device/probe/probe.xml").write_text("")
    return copy


def built(copy, what):
    """Return the path of what setuptools builds from a copy, and what was said meanwhile."""
    build = f"from setuptools import build_meta; print(build_meta.build_{what}('.'))"
    done = subprocess.run([sys.executable, "-c", build], cwd=copy, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return copy / done.stdout.splitlines()[-1], done.stdout + done.stderr


@pytest.mark.exhaustive
def test_the_wheel_holds_the_packages_whole_and_compiled_and_nothing_else(project_copy):
    path, said = built(project_copy, "wheel")
    assert not [line for line in said.splitlines() if "warning:" in line and "native/" in line]
    with zipfile.ZipFile(path) as archive:
        names = set(archive.namelist())
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith((".dist-info", ".data"))} == set(PACKAGES)
    modules = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    assert {path.relative_to(ROOT).as_posix() for path in modules} <= names
    markers = {f"{package}/py.typed" for package in PACKAGES}
    compiled = {"audioflinger_hook/core/haptic_cushion.so", "device/blocks_library.so"}
    assert markers | compiled | {"device/probe/probe.toml", "device/probe/probe.xml"} <= names
    assert [name for name in names if name.endswith("/LICENSE")]
    suffixes = {Path(name).suffix for name in names if name.split("/")[0] in PACKAGES}
    page = {".html", ".css", ".js", ".svg", ".wasm", ".webmanifest", ".LICENSE"}
    read = {".typed", ".toml", ".xml", ".json", ".conf", ".service", ".txt", ".md"}
    assert suffixes <= {".py", ".so"} | read | page


CORE = ("core", "core/drive", "plugin/native", "transform/native")


@pytest.mark.parametrize(
    ("number", "folders"),
    [(0, [f"audioflinger_hook/{folder}" for folder in CORE]), (1, ["device/native"])],
)
def test_every_source_is_built_and_every_header_rebuilds_it(number, folders):
    extension = PROJECT["tool"]["setuptools"]["ext-modules"][number]
    depends = [name for name in extension["depends"] if name.endswith(".h")]
    for pattern, names in (("*.c", extension["sources"]), ("*.h", depends)):
        found = [path for folder in folders for path in (ROOT / folder).glob(pattern)]
        assert names == sorted(path.relative_to(ROOT).as_posix() for path in found)
    assert "pyproject.toml" in extension["depends"]


@pytest.mark.exhaustive
def test_the_sdist_holds_the_sources_of_what_is_compiled(project_copy):
    with tarfile.open(built(project_copy, "sdist")[0]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    native = {*ROOT.glob("audioflinger_hook/transform/native/*"), *ROOT.glob("device/native/*")}
    assert {path.relative_to(ROOT).as_posix() for path in native} <= names
    assert not [name for name in names if name.endswith((".so", ".o"))]


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("source", "is_needed"),
    [("audioflinger_hook/transform/native/fft.c", True), ("device/native/blocks.c", False)],
)
def test_no_wheel_lacks_the_core_and_one_without_the_rigs_library_is_built_all_the_same(
    source, is_needed, project_copy, tmp_path
):
    broken = shutil.copytree(project_copy, tmp_path / "broken")
    for name in ("build", "haptic_cushion.egg-info"):
        shutil.rmtree(broken / name, ignore_errors=True)
    (broken / source).write_text("no C at all")
    options = (broken / "pyproject.toml").read_text()
    (broken / "pyproject.toml").write_text(options.replace('"-O3"', '"-O0"'))  # compiled sooner
    if is_needed:
        with pytest.raises(AssertionError, match="fft"):
            built(broken, "wheel")
        return
    with zipfile.ZipFile(built(broken, "wheel")[0]) as archive:
        libraries = [name for name in archive.namelist() if name.endswith(".so")]
    assert libraries == ["audioflinger_hook/core/haptic_cushion.so"]


def test_the_version_is_in_the_changelog():
    version = audioflinger_hook.__version__
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text()


TARGETS = ["help", "run", "test", "test-all", "soak", "bench", "docs", "clean"]
TARGETS += ["test-exhaustive", "test-servers", "test-usb"]


@pytest.mark.parametrize("target", TARGETS)
def test_make_knows(target):
    make = shutil.which("make")
    if not make:
        pytest.skip("make is not here: install it with the system's package manager")
    env = {name: text for name, text in os.environ.items() if not name.startswith("MAKE")}
    command = [make, "--dry-run", "-C", str(ROOT), target]
    done = subprocess.run(command, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_is_executable_and_parses(script):
    assert os.access(ROOT / script, os.X_OK)
    shell = Path((ROOT / script).read_text().splitlines()[0]).name.removeprefix("env ")
    done = subprocess.run([shell, "-n", str(ROOT / script)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_set_up_names_no_sound_server():
    servers = r"pulseaudio|pipewire|wireplumber|jackd|systemctl"
    makefile = (ROOT / "Makefile").read_text().replace("test-pipewire", "")
    assert not re.search(servers, SET_UP.read_text() + makefile)


@pytest.fixture
def bare(tmp_path):
    """A copy of the scripts in a folder with a space, and a PATH with PROGRAMS and `add` only."""

    class Bare:
        folder = tmp_path / "a copy"
        bin = tmp_path / "bin"
        calls = tmp_path / "calls"

        def add(self, name, script="exit 1"):
            """A program that notes its call and then does `script`."""
            program = self.bin / name
            note = f'echo "{name} $*" >>"{self.calls}"' if name != "id" else ""
            program.write_text(f"#!/bin/sh\n{note}\n{script}\n")
            program.chmod(0o755)

        def run(self, script, *arguments, **env):
            command = ["sh", str(self.folder / "tools" / script.name), *arguments]
            env = {"PATH": str(self.bin), "PYTHON": sys.executable, **env}
            return subprocess.run(command, env=env, capture_output=True, text=True, timeout=60)

        def called(self):
            return self.calls.read_text().splitlines() if self.calls.exists() else []

    machine = Bare()
    (machine.folder / "tools").mkdir(parents=True)
    machine.bin.mkdir()
    for script in [SET_UP, FETCH, FETCH_SOUNDS, *SOURCED]:
        shutil.copy(script, machine.folder / "tools")
    shutil.copy(ROOT / "pyproject.toml", machine.folder)
    for name in PROGRAMS:
        found = shutil.which(name)
        assert found, name
        (machine.bin / name).symlink_to(found)
    return machine


@pytest.mark.parametrize("python", ["/nonexistent/python", "false"])
def test_the_set_up_refuses_a_python_that_does_not_run(bare, python):
    done = bare.run(SET_UP, "run", PYTHON=python)
    assert done.returncode == 1
    assert done.stderr == f"setup: error: PYTHON={python} is not a Python that runs\n"


def test_the_set_up_says_what_to_do_without_a_new_enough_python(bare):
    old = 'echo "$0"; echo 3.9; exit 1'
    for version in ["", ".11", ".12", ".13", ".14"]:
        bare.add(f"python3{version}", old)
    script = bare.folder / "tools" / SET_UP.name
    script.write_text(script.read_text().replace("/usr/bin/python3;", ";"))
    done = bare.run(SET_UP, "test", PYTHON="")
    assert done.returncode == 1
    assert "3.11 or newer is needed (python3 is 3.9)" in done.stderr
    assert "make test PYTHON=" in done.stderr


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("manager", "does", "expected"),
    [
        ("apt-get", "exit 0", r"sudo apt-get install --no-install-recommends .*\bgcc libc6-dev\b"),
        # Here apt knows no packages.
        ("apt-get", "exit 1", r"sudo apt-get update && sudo apt-get install .*\bgcc libc6-dev\b"),
        ("dnf", "exit 0", r"sudo dnf install .*\bgcc\b"),
        ("pacman", "exit 0", r"sudo pacman -S --needed .*\bgcc\b"),
        ("zypper", "exit 0", r"sudo zypper install .*\bgcc\b"),
    ],
)
def test_without_the_right_to_install_the_set_up_prints_the_command(bare, manager, does, expected):
    bare.add("id", "echo 1000")
    bare.add("sudo")
    bare.add(manager, does)
    done = bare.run(SET_UP, "run")
    assert done.returncode == 1
    assert re.fullmatch(expected, done.stderr.splitlines()[-1].strip())
    assert not [call for call in bare.called() if call.startswith(f"{manager} install")]
    assert not (bare.folder / ".venv").exists()


@pytest.mark.parametrize("fetch", [FETCH, FETCH_SOUNDS])
def test_without_apt_the_recordings_are_left_out_in_one_line(bare, fetch):
    done = bare.run(fetch)
    assert (done.returncode, len(done.stderr.splitlines())) == (0, 1)
    assert not (bare.folder / ".cache").exists()


@pytest.mark.parametrize("fetch", [FETCH, FETCH_SOUNDS])
def test_without_a_network_the_recordings_leave_no_half_cache(bare, fetch):
    listed = bare.folder / SOUND_LIST.relative_to(ROOT)
    listed.parent.mkdir(parents=True)
    shutil.copy(SOUND_LIST, listed)
    bare.add("id", "echo 1000")
    for name in ["apt-get", "apt-cache", "dpkg-deb", "sudo", "python3"]:
        bare.add(name)
    done = bare.run(fetch)
    assert done.returncode == 0, done.stderr
    assert (len(done.stderr.splitlines()), list((bare.folder / ".cache").iterdir())) == (1, [])


def test_recordings_that_are_there_are_kept(bare):
    mine = bare.folder / "mine" / "speech.wav"
    mine.parent.mkdir()
    mine.touch()
    bare.add("apt-get")
    assert bare.run(FETCH, CUSHION_RECORDINGS="mine").returncode == 0
    assert bare.run(FETCH_SOUNDS, CUSHION_SOUNDS="mine").returncode == 0
    assert mine.exists()
    assert bare.called() == []


@pytest.mark.skipif(not IN_CI, reason="only with CI=true, where nothing may be left out")
def test_in_ci_there_are_recordings_and_matplotlib():
    assert {path.suffix for path in recordings()} == {".wav", ".oga"}, WHY_NONE
    assert importlib.util.find_spec("matplotlib")
