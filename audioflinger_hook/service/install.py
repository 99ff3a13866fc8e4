"""The text and the installation of the systemd user unit, and the text of the udev rule."""

import os
import re
import stat
import string
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from subprocess import DEVNULL, SubprocessError, check_output

from audioflinger_hook.service.one_line import one_line
from device.atomic_file import make_private_folder, remove_file, write_private
from device.errors import UsageError

NAME = "cushion.service"
MARK = "# Written by `cushion install-service`."  # first words of every unit of this program
NOTIFY_RELOAD = 253  # first version of systemd with Type=notify-reload

UDEV_PATH = "/etc/udev/rules.d/70-cushion.rules"  # the name must sort before 73-seat-late.rules

_TEMPLATE = string.Template(
    files("audioflinger_hook.service").joinpath(NAME).read_text(encoding="utf-8")
)


def unit_text(command: Sequence[str], state_folder: Path, systemd: int = 0) -> str:
    """Return the text of a unit that runs `command`, which must begin with an absolute path.

    state_folder: the daemon may write to this folder. systemd: version of systemd, 0 if unknown.
    UsageError: systemd does not accept a path or argument.
    """
    program, *arguments = command
    words = [_path(program, "install the program elsewhere"), *map(_quoted, arguments)]
    # The prefix "-" permits a missing folder.
    writable = _path(str(state_folder), "set XDG_STATE_HOME to another", "-")
    reloads = systemd >= NOTIFY_RELOAD
    return _TEMPLATE.substitute(
        mark=MARK,
        type="notify-reload" if reloads else "notify",
        command=" ".join(words),
        reload="ReloadSignal=SIGHUP" if reloads else "ExecReload=/bin/kill -HUP $MAINPID",
        writable=f"ReadWritePaths={writable}",
    )


def _path(path: str, advice: str, prefix: str = "") -> str:
    # systemd refuses these characters even in quoted paths. $ needs no escape in paths.
    if not path.startswith("/") or any(sign in path for sign in "\"'\\"):
        raise UsageError(
            f"systemd cannot use the path {one_line(path)!r}; allowed: an absolute path without "
            f"quotes and backslashes; {advice}"
        )
    return f'"{prefix}{_printable(path).replace("%", "%%")}"'


def _quoted(argument: str) -> str:
    text = _printable(argument).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{text.replace("%", "%%").replace("$", "$$")}"'


def _printable(text: str) -> str:
    if not text.isprintable():
        problem = "it has unprintable characters; choose another name"
        raise UsageError(f"systemd cannot use {one_line(text)!r}: {problem}")
    return text


UDEV_RULE = """\
# Haptic Cushion: the logged-in user may access USB audio devices directly.
ACTION!="remove", SUBSYSTEM=="usb", ENV{DEVTYPE}=="usb_device", \
ENV{ID_USB_INTERFACES}=="*:0101??:*", TAG+="uaccess"
"""
"""Gives the user at the computer access to USB devices that have an audio control interface."""

UDEV_COMMAND = (  # shell command, which requires root
    f"sudo tee {UDEV_PATH} >/dev/null <<'END'\n{UDEV_RULE}END\n"
    "sudo udevadm control --reload && "
    "sudo udevadm trigger --subsystem-match=usb --action=change\n"
)


OWN_BYTES_MAX = 1 << 16
RELOAD = "systemctl --user daemon-reload"
START = ("systemctl --user enable cushion.service", "systemctl --user restart cushion.service")
RESTART = (RELOAD, "systemctl --user try-restart cushion.service")  # if it is running
FORGET = ("systemctl --user stop cushion.service", RELOAD)


@dataclass(frozen=True)
class Installed:
    """Result of an installation or removal. path: path of the unit. changed: whether it changed.

    commands: shell commands that the user must run next.
    """

    path: Path
    changed: bool
    commands: tuple[str, ...]


def own_command(argv0: str = sys.argv[0], python: str = sys.executable) -> tuple[str, ...]:
    """Return the command that starts this program: the path of `cushion`, or Python with -m.

    Links are not resolved, because a virtual environment's Python is a link.
    """
    script = Path(argv0).absolute()
    if script.name == "cushion" and script.is_file() and os.access(script, os.X_OK):
        return (str(script),)
    return (str(Path(python).absolute()), "-m", "audioflinger_hook")


def systemd_version() -> int:
    """Return the version of systemd, or 0 if `systemctl` does not report the version."""
    found = re.match(r"systemd (\d{1,6})\b", printed("systemctl", "--version"), re.ASCII)
    return int(found[1]) if found else 0


def printed(*command: str, environ: Mapping[str, str] = os.environ, limit_s: float = 5.0) -> str:
    """Return what a program prints; "" if it is missing, fails or takes over `limit_s`."""
    with suppress(OSError, SubprocessError):
        done = check_output(command, env=environ, stdin=DEVNULL, stderr=DEVNULL, timeout=limit_s)
        return done.decode(errors="replace")
    return ""


def unit_path(environ: Mapping[str, str]) -> Path:
    """Return the path of the unit. UsageError: no home folder is known."""
    return home_folder(environ, "XDG_CONFIG_HOME", ".config") / "systemd" / "user" / NAME


def install(
    arguments: Sequence[str] = (),
    command: Sequence[str] | None = None,
    environ: Mapping[str, str] = os.environ,
    systemd: int = 0,
) -> Installed:
    """Write the unit that runs `cushion run` with `arguments`; create missing folders.

    command: by default `own_command()`. systemd: version of systemd, 0 if unknown.
    UsageError: systemd does not accept a path or argument, no home folder is known, a folder is not
    writable, or another program wrote the unit. WriteError: the disk is full or failed.
    """
    installed_text(environ)  # refuses a unit of another program before folders are created
    state = state_folder(environ)
    text = unit_text([*(command or own_command()), "run", *arguments], state, systemd)
    make_private_folder(state)
    return replace(restore(text, environ), commands=START)


def installed_text(environ: Mapping[str, str] = os.environ) -> str | None:
    """Return the unit's text, or None. UsageError: no home folder, or a unit of another program."""
    return own_text(unit_path(environ), MARK)


def restore(text: str | None, environ: Mapping[str, str] = os.environ) -> Installed:
    """Write `text` as the unit, or remove the unit if `text` is None. Errors: see `install`."""
    path = unit_path(environ)
    changed = replace_own(path, MARK, text)
    return Installed(path, changed, FORGET * changed if text is None else RESTART)


def own_text(path: Path, mark: str) -> str | None:
    """Return the text of a file of this program, which begins with `mark`; None without a file.

    UsageError: another program wrote the file, or it cannot be read.
    """
    try:
        found = path.lstat()
        is_usual = stat.S_ISREG(found.st_mode) and found.st_size <= OWN_BYTES_MAX
        text = path.read_text(encoding="utf-8", errors="replace") if is_usual else ""
    except (FileNotFoundError, NotADirectoryError):  # `replace_own` reports NotADirectoryError
        return None
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}; move it away first") from error
    if not text.startswith(mark):
        raise UsageError(
            f"{path} was not written by `cushion` and is left alone; move it away first"
        )
    return text


def replace_own(path: Path, mark: str, text: str | None) -> bool:
    """Write a file of this program, or remove it if `text` is None; return whether it changed.

    UsageError: see `own_text`, or a folder is not writable. WriteError: the disk is full or failed.
    """
    before = own_text(path, mark)
    if text is None:
        remove_file(path)
    elif text != before:
        write_private(path, text.encode())
    return text != before


def state_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """Return the state folder. UsageError: neither XDG_STATE_HOME nor HOME is an absolute path."""
    return home_folder(environ, "XDG_STATE_HOME", ".local/state") / "cushion"


def home_folder(environ: Mapping[str, str], variable: str, otherwise: str) -> Path:
    """Return an XDG base folder: the variable's, else `otherwise` in the user's home.

    UsageError: neither the variable nor HOME is an absolute path.
    """
    text = environ.get(variable, "")
    # By the XDG specification, relative paths are ignored.
    if text.startswith("/"):
        return Path(text)
    home = environ.get("HOME", "")
    if not home.startswith("/"):
        raise UsageError(f"neither {variable} nor HOME is an absolute path; set one of them")
    return Path(home) / otherwise
