"""Reads versions, permissions, folders, the plugin's files, the config and the daemon."""

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
from audioflinger_hook.config.file import Config, default_path
from audioflinger_hook.config.toml_text import Mistake
from audioflinger_hook.core import library_path
from audioflinger_hook.daemon.native.abilities import missing_parts
from audioflinger_hook.doctor.facts import Facts, Folder
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
    folder_path,
)
from audioflinger_hook.service.status_client import ask_status
from device.errors import CushionError, NotFoundError
from device.stream import AudioPriority
from device.stream.pcms import missing_plugin

ANSWER_S = 3.0  # longest time in s for one program, server or daemon to answer

FindMistakes = Callable[[Path], tuple[Config | None, list[str], list[Mistake]]]

_RTKIT = "org.freedesktop.RealtimeKit1"
_BUS = "org.freedesktop.DBus"
# Programs that list the services of the system bus; the first that exists is used.
_BUS_COMMANDS = (
    f"busctl --system call {_BUS} / {_BUS} ListActivatableNames".split(),
    f"dbus-send --system --print-reply --dest={_BUS} / {_BUS}.ListActivatableNames".split(),
)


def printed(*command: str) -> str:
    """Return the output of a program; "" if it is missing, fails or takes over ANSWER_S."""
    with suppress(OSError, subprocess.SubprocessError):
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=ANSWER_S, check=True
        )
        return done.stdout.decode(errors="replace")
    return ""


def read_machine(environ: Mapping[str, str]) -> Facts:
    """Return versions and permissions of this machine and user, folders and the plugin's files."""
    distribution = ""
    with suppress(OSError):
        distribution = platform.freedesktop_os_release().get("PRETTY_NAME", "")
    kernel = f"{platform.system()} {platform.release()} {platform.machine()}"
    return Facts(
        program=__version__,
        system=f"Python {platform.python_version()}, {distribution}, {kernel}",
        pipewire=_version("pipewire"),
        wireplumber=_version("wireplumber"),
        is_root=os.geteuid() == 0,
        priority=_priority(),
        rtprio_limit=resource.getrlimit(resource.RLIMIT_RTPRIO)[0],
        rtkit=_rtkit(),
        folders=(
            _folder("runtime", lambda: _runtime_folder(environ), environ.get(VARIABLE, "")),
            _folder("state", lambda: state_folder(environ)),
            _folder("config", lambda: default_path().parent),
        ),
        is_built=library_path() is not None,
        installed=_installed(environ),
        native_problem=missing_parts(),
        alsa_problem=missing_plugin(),
    )


def read_config(facts: Facts, find_mistakes: FindMistakes) -> Facts:
    """Return the facts with those of the config file, if there is one.

    find_mistakes: returns settings, warnings and mistakes of a config file.
    """
    path = default_path()
    if not path.exists():
        return facts
    try:
        found, warnings, mistakes = find_mistakes(path)
    except CushionError as error:
        return replace(facts, config_error=str(error))
    facts = replace(facts, mistakes=tuple(mistakes), config_warnings=tuple(warnings))
    if found is None:
        return facts
    live = found.live
    return replace(facts, tap=live.tap[0], device=live.device or "", engine=live.engine)


def read_daemon(facts: Facts, clock: Callable[[], float], environ: Mapping[str, str]) -> Facts:
    """Return the facts with those of this user's daemon. clock: returns seconds."""
    status, error = None, ""
    try:
        status = ask_status(ANSWER_S, clock, environ)
    except NotFoundError:  # no daemon runs
        pass
    except CushionError as refusal:
        error = str(refusal)
    holder, is_locked = _read_lock(environ)
    # `systemctl` prints the state also if it returns another code than 0.
    service = printed("sh", "-c", f"systemctl --user is-active {SERVICE} || true").strip()
    known = replace(facts, status=status, daemon_error=error, service=service)
    return replace(known, holder=holder, is_locked=is_locked)


def _version(program: str) -> str:
    return (printed(program, "--version").split() or [""])[-1]


def _priority() -> str:
    """Return the priority that an audio thread of this user gets; see `Facts`."""
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
            return _RTKIT in printed(*command)
    return None


def _runtime_folder(environ: Mapping[str, str]) -> Path:
    with suppress(NotFoundError), RuntimeFolder(environ, create=False):  # the daemon makes it
        pass
    return folder_path(environ)


def _folder(what: str, path_of: Callable[[], Path], named: str = "") -> Folder:
    """Return the facts of a folder. named: the path that the user gave."""
    try:
        path = path_of()
    except CushionError as error:
        path = Path(named)
        can_make = path.is_absolute() and not path.exists() and os.access(path.parent, os.W_OK)
        return Folder(what, named, problem=str(error), can_make=can_make)
    existing = next((one for one in (path, *path.parents) if one.exists()), Path("/"))
    problem = ""
    if not existing.is_dir():
        problem = f"{existing} is not a folder; rename or remove it"
    elif not os.access(existing, os.W_OK | os.X_OK):
        problem = f"this user may not write to {existing}; change its owner or rights"
    free_bytes = None
    with suppress(OSError):
        disk = os.statvfs(existing)
        free_bytes = disk.f_bavail * disk.f_frsize
    return Folder(what, str(path), free_bytes, problem)


def _installed(environ: Mapping[str, str]) -> str:
    built = library_path()
    with suppress(CushionError, OSError):
        places = Places.of(environ)
        if places.plugin.is_file():
            is_same = built is None or places.plugin.read_bytes() == built.read_bytes()
            return "current" if is_same else "of another version"
        if places.chain.exists() or places.bundle.exists():
            return "missing"
    return ""


def _read_lock(environ: Mapping[str, str]) -> tuple[Holder | None, bool]:
    """Return the daemon that the lock file names, and whether a process holds the lock.

    This reads the kernel's list of locks: to try the lock could stop a daemon that starts now.
    """
    holder, is_locked = None, False
    with suppress(CushionError, OSError), RuntimeFolder(environ, create=False) as folder:
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        with os.fdopen(os.open(LOCK_NAME, flags, dir_fd=folder.fd), "rb") as file:
            found = os.fstat(file.fileno())
            if stat.S_ISREG(found.st_mode):
                locks = Path("/proc/locks").read_text().splitlines()
                is_locked = any(f":{found.st_ino} " in one and "FLOCK" in one for one in locks)
                if text := file.read(HOLDER_BYTES_MAX):
                    holder = from_json(Holder, text)
    return holder, is_locked
