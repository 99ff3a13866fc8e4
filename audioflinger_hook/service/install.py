"""Installs and removes the systemd user unit."""

from __future__ import annotations

import os
import re
import stat
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from audioflinger_hook.service import unit
from device.atomic_file import make_private_folder, write_bytes_atomically
from device.errors import UsageError

UNIT_BYTES_MAX = 1 << 16
SYSTEMCTL_S = 5.0
START = ("systemctl --user daemon-reload", "systemctl --user enable --now cushion.service")
FORGET = ("systemctl --user daemon-reload",)


@dataclass(frozen=True)
class Installed:
    """The unit's path, whether it has changed, and the commands to type next."""

    path: Path
    changed: bool
    commands: tuple[str, ...]


def own_command(argv0: str = sys.argv[0], python: str = sys.executable) -> tuple[str, ...]:
    """Return the command that starts this program: `cushion`, or Python with -m.

    Links are not resolved, as the Python behind a virtual environment's link lacks its packages.
    """
    script = Path(argv0).absolute()
    if script.name == "cushion" and script.is_file() and os.access(script, os.X_OK):
        return (str(script),)
    return (str(Path(python).absolute()), "-m", "audioflinger_hook")


def systemd_version() -> int:
    """Return the version of systemd, 0 if there is none."""
    try:
        told = subprocess.run(
            ["systemctl", "--version"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=SYSTEMCTL_S,
        ).stdout
    except (OSError, subprocess.TimeoutExpired):
        return 0
    found = re.match(r"systemd (\d{1,6})\b", told)
    return int(found[1]) if found else 0


def _unit_path(environ: Mapping[str, str]) -> Path:
    return _home(environ, "XDG_CONFIG_HOME", ".config") / "systemd" / "user" / unit.NAME


def install(
    arguments: Sequence[str] = (),
    command: Sequence[str] | None = None,
    environ: Mapping[str, str] = os.environ,
    systemd: int = 0,
) -> Installed:
    """Write the unit that runs `cushion run` with these arguments.

    Makes missing folders, and writes the file atomically if its text differs. The returned
    commands load and start it. command: default `own_command`; systemd: `systemd_version`.

    UsageError: systemd does not accept a path or argument, a folder is not writable, or the unit
    was not written by this program.
    WriteError: the disk is full or failed.
    """
    path = _unit_path(environ)
    state = state_folder(environ)
    text = unit.unit_text([*(command or own_command()), "run", *arguments], state, systemd)
    before = _written_before(path)
    make_private_folder(state)
    if before != text:
        _write(path, text)
    return Installed(path, before != text, START)


def installed_text(environ: Mapping[str, str] = os.environ) -> str | None:
    """Return the text of the unit that `install` wrote, None without one. UsageError: as there."""
    return _written_before(_unit_path(environ))


def restore(text: str | None, environ: Mapping[str, str] = os.environ) -> Installed:
    """Write or remove the unit, so that it is again what `installed_text` returned.

    UsageError, WriteError: as for `install`.
    """
    if text is None:
        return remove(environ)
    path = _unit_path(environ)
    changed = _written_before(path) != text
    if changed:
        _write(path, text)
    return Installed(path, changed, START)


def state_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """Return the folder of what this program keeps for itself. UsageError: there is no home."""
    return _home(environ, "XDG_STATE_HOME", ".local/state") / "cushion"


def _write(path: Path, text: str) -> None:
    make_private_folder(path.parent)
    write_bytes_atomically(path, text.encode())


def remove(environ: Mapping[str, str] = os.environ) -> Installed:
    """Remove the unit that `install` wrote, if there is one.

    UsageError: the unit was not written by this program, or the folder is not writable.
    """
    path = _unit_path(environ)
    if _written_before(path) is None:
        return Installed(path, False, ())
    try:
        path.unlink()
    except OSError as error:
        raise UsageError(f"cannot remove {path}: {error.strerror}; remove it yourself") from error
    return Installed(path, True, FORGET)


def _written_before(path: Path) -> str | None:
    """Return the text of the installed unit, or None."""
    text = ""
    with suppress(OSError, UnicodeDecodeError):
        try:
            found = path.lstat()
        except (FileNotFoundError, NotADirectoryError):  # `install` reports NotADirectoryError
            return None
        if stat.S_ISREG(found.st_mode) and found.st_size <= UNIT_BYTES_MAX:
            text = path.read_text(encoding="utf-8")
    if not text.startswith(unit.MARK):
        raise UsageError(
            f"{path} was not written by `cushion install-service` and is left alone; "
            "move it away first"
        )
    return text


def _home(environ: Mapping[str, str], variable: str, otherwise: str) -> Path:
    text = environ.get(variable, "")
    # The XDG specification requires that relative paths be ignored.
    if text.startswith("/"):
        return Path(text)
    home = environ.get("HOME", "")
    if not home.startswith("/"):
        raise UsageError(f"neither {variable} nor HOME is an absolute path; set one of them")
    return Path(home) / otherwise
