"""C programs of the tests, built by every compiler that is here, for this processor and for ARM."""

import hashlib
import importlib.util
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CORE = ROOT / "audioflinger_hook/core"
CORE_SOURCES = [
    path
    for folder in (CORE, CORE / "drive", ROOT / "audioflinger_hook/transform/native")
    for path in sorted(folder.glob("*.c"))
]
"""The sources of the core, without its hosts."""

FLAGS = ["-std=gnu11", "-ffp-contract=off", "-fno-math-errno", "-Wall", "-Wextra", "-Werror"]

ZIG = [sys.executable, "-m", "ziglang", "cc"]
"""The clang of the package `ziglang`, which also compiles for other processors."""

BUILDS: dict[str, list[str]] = {
    "gcc -O1": ["gcc", "-O1"],
    "gcc -O3": ["gcc", "-O3"],
    "gcc -O3 -mavx2 -mfma": ["gcc", "-O3", "-mavx2", "-mfma"],
    "clang -O3": ["clang", "-O3"],
    "zig -O2": [*ZIG, "-O2", "-fno-sanitize=undefined"],
    "aarch64 -O2": [*ZIG, "-O2", "-fno-sanitize=undefined", "-target", "aarch64-linux-musl"],
}

FAST = "gcc -O1"  # the quickest to compile
EACH_BUILD = [
    name if name == FAST else pytest.param(name, marks=pytest.mark.exhaustive) for name in BUILDS
]
"""For parametrize: one build among the fast tests, all in the exhaustive set."""


def require_build(name: str) -> list[str]:
    """Return the compiler's command; skip the test where it, or what runs its programs, lacks."""
    command = BUILDS[name]
    if command[0] == sys.executable:
        if importlib.util.find_spec("ziglang") is None:
            pytest.skip("the package ziglang is not installed")
    elif shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not installed")
    if name.startswith("aarch64") and emulator() is None:
        pytest.skip("qemu-user is not installed")
    return command


def emulator() -> str | None:
    """Return the program that runs those of 64-bit ARM, None where there is none."""
    return shutil.which("qemu-aarch64-static") or shutil.which("qemu-aarch64")


def built(name: str, program: Path, sources: list[Path], includes: list[Path]) -> list[str]:
    """Build a program unless it is there already; return the command that runs it."""
    command = require_build(name)
    headers = sorted({path for source in sources for path in source.parent.glob("*.h")})
    key = hashlib.sha256(repr(command).encode())
    for path in (*sources, *headers, program):
        key.update(path.read_bytes())
    done = ROOT / "build" / f"{program.stem}-{key.hexdigest()[:16]}"
    if not done.exists():
        done.parent.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=done.parent) as folder:
            made = Path(folder) / done.name
            searched = [f"-I{folder}" for folder in includes]
            inputs = map(str, (program, *sources))
            subprocess.run([*command, *FLAGS, *searched, *inputs, "-lm", "-o", made], check=True)
            made.replace(done)
    if name.startswith("aarch64"):
        return [str(emulator()), str(done)]
    return [str(done)]
