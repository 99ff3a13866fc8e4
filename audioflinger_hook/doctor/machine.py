"""Reads versions, real-time permission, folders, the plugin's files and the daemon."""

from __future__ import annotations

import os
import platform
import resource
import shutil
import stat
import subprocess
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from audioflinger_hook import __version__
from audioflinger_hook.config.file import default_path
from audioflinger_hook.core import library_path
from audioflinger_hook.daemon.native.abilities import missing_parts
from audioflinger_hook.doctor.facts import DaemonFacts, FolderFacts, PluginFacts, SystemFacts
from audioflinger_hook.plugin.install import Places
from audioflinger_hook.service.install import NAME as SERVICE
from audioflinger_hook.service.install import state_folder
from audioflinger_hook.service.json_codec import from_json
from audioflinger_hook.service.runtime_folder import (
    HOLDER_BYTES_MAX,
    LOCK_NAME,
    VARIABLE,
    Holder,
    RuntimeFolder,
)
from audioflinger_hook.service.status_client import ask_status
from device.errors import CushionError, NotFoundError
from device.stream import AudioPriority
from device.stream.pcms import missing_plugin

ANSWER_S = 3.0  # longest time in s for one program, server or daemon to answer

_RTKIT = "org.freedesktop.RealtimeKit1"
_BUS = "org.freedesktop.DBus"
# Programs that list the services of the system bus; the first that exists is used.
_BUS_COMMANDS = (
    f"busctl --system call {_BUS} / {_BUS} ListActivatableNames".split(),
    f"dbus-send --system --print-reply --dest={_BUS} / {_BUS}.ListActivatableNames".split(),
)


def printed(*command: str) -> str | None:
    """Return the output of a program; None if it is missing, fails or takes over ANSWER_S."""
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=ANSWER_S, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.decode(errors="replace")


def read_system() -> SystemFacts:
    """Return versions and permissions of this machine and user."""
    distribution = ""
    with suppress(OSError):
        distribution = platform.freedesktop_os_release().get("PRETTY_NAME", "")
    return SystemFacts(
        program=__version__,
        python=platform.python_version(),
        kernel=f"{platform.system()} {platform.release()} {platform.machine()}",
        distribution=distribution,
        pipewire=_version("pipewire"),
        wireplumber=_version("wireplumber"),
        is_root=os.geteuid() == 0,
        priority=_priority(),
        rtprio_limit=resource.getrlimit(resource.RLIMIT_RTPRIO)[0],
        rtkit=_rtkit(),
    )


def read_folders(environ: Mapping[str, str]) -> tuple[FolderFacts, ...]:
    """Return the folders of the daemon's lock, of the state and of the config."""
    return (
        _runtime_folder(environ),
        _folder("state", lambda: state_folder(environ)),
        _folder("config", lambda: default_path().parent),
    )


def read_plugin(environ: Mapping[str, str]) -> PluginFacts:
    """Return the state of the plugin's files."""
    built, installed = library_path(), ""
    with suppress(CushionError, OSError):
        places = Places.of(environ)
        if places.plugin.is_file():
            is_same = built is None or places.plugin.read_bytes() == built.read_bytes()
            installed = "current" if is_same else "other version"
        elif places.chain.exists() or places.bundle.exists():
            installed = "missing"
    return PluginFacts(str(built or ""), installed, missing_parts(), missing_plugin())


def read_daemon(clock: Callable[[], float], environ: Mapping[str, str]) -> DaemonFacts:
    """Return the state of this user's daemon, without its applications. clock: returns seconds."""
    status, error = None, ""
    try:
        status = replace(ask_status(ANSWER_S, clock, environ), applications=())
    except NotFoundError:  # no daemon runs
        pass
    except CushionError as refusal:
        error = str(refusal)
    holder, is_locked = _read_lock(environ)
    # `systemctl` prints the state also if it returns another code than 0.
    service = printed("sh", "-c", f"systemctl --user is-active {SERVICE} || true") or ""
    return DaemonFacts(status, error, holder, is_locked, service.strip())


def _version(program: str) -> str:
    words = (printed(program, "--version") or "").split()
    return words[-1] if words else ""


def _priority() -> str:
    """Return the priority that an audio thread of this user gets; see `SystemFacts`."""
    priority, found = AudioPriority(), [""]

    def claim() -> None:
        priority.claim()
        policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        is_real_time = policy in (os.SCHED_RR, os.SCHED_FIFO)
        found[0] = "real-time" if is_real_time else "" if priority.warning else "nice"

    thread = threading.Thread(target=claim, name="priority")
    thread.start()
    thread.join()
    return found[0]


def _rtkit() -> bool | None:
    for command in _BUS_COMMANDS:
        if shutil.which(command[0]):
            return _RTKIT in (printed(*command) or "")
    return None


def _runtime_folder(environ: Mapping[str, str]) -> FolderFacts:
    base = environ.get(VARIABLE, "")
    try:
        with RuntimeFolder(environ, create=False) as folder:
            return FolderFacts("runtime", str(folder.path), _free_bytes(folder.path))
    except NotFoundError:  # the daemon makes it
        return _folder("runtime", lambda: Path(base or f"/run/user/{os.geteuid()}"))
    except CushionError as error:
        path = Path(base)
        can_make = path.is_absolute() and not path.exists() and os.access(path.parent, os.W_OK)
        return FolderFacts("runtime", base, problem=str(error), can_make=can_make)


def _folder(what: str, path_of: Callable[[], Path]) -> FolderFacts:
    try:
        path = path_of()
    except CushionError as error:
        return FolderFacts(what, "", problem=str(error))
    existing = next((one for one in (path, *path.parents) if one.exists()), Path("/"))
    problem = ""
    if not existing.is_dir():
        problem = f"{existing} is not a folder; rename or remove it"
    elif not os.access(existing, os.W_OK | os.X_OK):
        problem = f"this user may not write to {existing}; change its owner or rights"
    return FolderFacts(what, str(path), _free_bytes(existing), problem)


def _free_bytes(path: Path) -> int | None:
    with suppress(OSError):
        disk = os.statvfs(path)
        return disk.f_bavail * disk.f_frsize
    return None


def _read_lock(environ: Mapping[str, str]) -> tuple[Holder | None, bool]:
    """Return the daemon that the lock file names, and whether a process holds the lock.

    This reads the kernel's list of locks: to try the lock could stop a daemon that starts now.
    """
    holder, is_locked = None, False
    with suppress(CushionError, OSError), RuntimeFolder(environ, create=False) as folder:
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        file = os.open(LOCK_NAME, flags, dir_fd=folder.fd)
        try:
            found = os.fstat(file)
            if stat.S_ISREG(found.st_mode):
                locks = Path("/proc/locks").read_text().splitlines()
                is_locked = any(f":{found.st_ino} " in one and "FLOCK" in one for one in locks)
                if text := os.pread(file, HOLDER_BYTES_MAX, 0):
                    holder = from_json(Holder, text)
        finally:
            os.close(file)
    return holder, is_locked
