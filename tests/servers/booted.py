"""A container of this machine's own files whose init is systemd, for one command.

Its root is this machine's, under a layer in memory, so that the command is found where it is here;
one folder is shared. Processes, mounts, network, names and cgroups are its own, and no service of
this machine starts in it but what is needed to log in.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.servers.listening import wait_for
from tests.support.data import text

ROOT = Path(__file__).resolve().parents[2]
INIT = Path("/lib/systemd/systemd")
PROGRAMS = ("unshare", "loginctl", "runuser", "useradd")
MNT_DETACH = 2
NO_CONTAINER = 97  # exit code: the kernel, or a container around this, refused

# Arguments: the container's cgroup, its script and that script's arguments.
_ENTER = """
echo 0 >"$1"/cgroup.procs || exit 97
shift
exec unshare --cgroup --mount --uts --ipc --net --propagation private /bin/sh -ec "$@"
"""

# Without setns, a `chroot` around this would remain, in which users may make no namespaces.
_PIVOT = f"""
import ctypes, os
libc, here, own = ctypes.CDLL(None), os.open(".", 0), os.open("/proc/self/ns/mnt", 0)
if libc.setns(own, 0) or os.fchdir(here) or libc.pivot_root(b".", b"old"):
    os._exit({NO_CONTAINER})
os.chdir("/")
libc.umount2(b"/old", {MNT_DETACH})
environ = dict(container="cushion", PATH="/usr/sbin:/usr/bin:/sbin:/bin")
os.execve("{INIT}", ["{INIT}", "--unit=booted.service"], environ)
"""

_BOOT = text("boot.sh")

_SERVICE = text("booted.service")


def _cgroups() -> Path | None:
    """Where the second version of cgroups is mounted."""
    mounts = (line.split() for line in Path("/proc/mounts").read_text().splitlines())
    return next((Path(words[1]) for words in mounts if words[2] == "cgroup2"), None)


def why_not() -> str:
    """What is missing for such a container, "" for nothing."""
    if os.geteuid() != 0:
        return "a container with systemd needs root"
    missing = [name for name in PROGRAMS if not shutil.which(name)]
    folders = ("usr/lib*/security", "usr/lib/*/security")
    if not any(True for each in folders for _ in Path("/").glob(f"{each}/pam_systemd.so")):
        missing.append("pam_systemd")
    if missing or not INIT.exists():
        return f"missing: {', '.join(missing) or 'systemd'}; run tools/fetch_servers.sh"
    return "" if _cgroups() else "cgroups of version 2 are not mounted"


def run(shared: Path, command: Sequence[str], limit_s: float) -> None:
    """Boot, run the command inside as root, end.

    What it wrote is in `shared`/output. AssertionError: it failed. TimeoutExpired: it did not end.
    Skips where no container can be made.
    """
    cgroups: Any = _cgroups()
    cgroup, layer = cgroups / f"cushion-test-{os.getpid()}", shared / "layer"
    layer.mkdir()
    words = " ".join(f'"{word}"' for word in command)
    (shared / "booted.service").write_text(_SERVICE.format(root=ROOT, command=words, shared=shared))
    found = {ROOT, Path(sys.prefix).resolve(), Path(sys.base_prefix).resolve()}
    needed = [each for each in sorted(found) if not found.intersection(each.parents)]
    try:
        cgroup.mkdir()
    except OSError as error:
        pytest.skip(f"no cgroup for a container: {error}")
    try:
        done = subprocess.run(
            ["unshare", "--pid", "--fork", "--kill-child", "/bin/sh", "-c", _ENTER, "enter"]
            + [str(each) for each in (cgroup, _BOOT, "boot", layer, shared, *needed)],
            env=os.environ | {"PYTHON": sys.executable, "PIVOT": _PIVOT},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=limit_s,
        )
    finally:
        wait_for(lambda: _removed(cgroup), "end of the container")
    if done.returncode == NO_CONTAINER or not (shared / "output").exists():
        pytest.skip(f"no container with systemd here: {done.stderr.strip()[-300:]}")
    told = [shared / name for name in ("output", "journal")]
    tails = [each.read_text(errors="replace")[-4_000:] for each in told if each.exists()]
    assert done.returncode == 0, "\n".join(tails)


def _removed(cgroup: Path) -> bool:
    try:
        for folder, _, _ in os.walk(cgroup, topdown=False):
            Path(folder).rmdir()
    except OSError:
        return False
    return True
