"""The systemd user unit and the udev rule: their text, writing and removing the unit."""

from __future__ import annotations

import os
import re
import stat
import string
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from audioflinger_hook.service.one_line import one_line
from device.atomic_file import make_private_folder, write_bytes_atomically
from device.errors import UsageError

NAME = "cushion.service"
MARK = "# Written by `cushion install-service`."  # beginning of every unit that this program wrote

UDEV_PATH = "/etc/udev/rules.d/70-cushion.rules"
"""The number must be below that of 73-seat-late.rules, which reads the tag."""

_TEMPLATE = string.Template("""\
$mark Changes belong into a drop-in: systemctl --user edit cushion

[Unit]
Description=Haptic Cushion: sound to vibration
After=pipewire-pulse.service pulseaudio.service wireplumber.service
# a daemon that fails ten times in five minutes is left alone
StartLimitIntervalSec=300
StartLimitBurst=10

[Service]
Type=$type
NotifyAccess=main
ExecStart=$command
$reload
TimeoutStartSec=30
TimeoutStopSec=10
WatchdogSec=10
Restart=on-failure
RestartSec=2
# wrong config or usage stays wrong, what is not installed stays missing (devices are waited for);
# interrupted is a way to end
RestartPreventExitStatus=2 3
SuccessExitStatus=130

# its folder; kept, for a daemon that was started by hand may be using it
RuntimeDirectory=cushion
RuntimeDirectoryMode=0700
RuntimeDirectoryPreserve=yes
UMask=0077

# the audio threads may ask for real-time priority, as far as the user may have it; one that spins
# loses it, or ends the daemon
LimitRTPRIO=20
LimitRTTIME=200ms:2s
LimitCORE=0
MemoryMax=512M
OOMPolicy=stop

# what needs no privilege
NoNewPrivileges=yes
RestrictAddressFamilies=AF_UNIX AF_NETLINK
RestrictNamespaces=yes
RestrictSUIDSGID=yes
LockPersonality=yes
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallErrorNumber=EPERM

# what needs a user namespace; systemd goes without where there is none
ProtectSystem=strict
$writable
PrivateTmp=yes

[Install]
WantedBy=default.target
""")


NOTIFY_RELOAD = 253
"""First version of systemd that sends SIGHUP itself and waits for the end of the reload."""


def unit_text(command: Sequence[str], state_folder: Path, systemd: int = 0) -> str:
    """Return the unit that runs a command, which begins with an absolute path.

    state_folder: the daemon may write here and in the runtime folder. systemd: its version, 0 for
    any. UsageError: systemd does not accept a path or argument.
    """
    program, *arguments = command
    words = [_path(program, "install the program elsewhere"), *map(_quoted, arguments)]
    # The folder may be missing.
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
    # systemd refuses these characters in paths even if quoted. It expands no variables there, so
    # dollar signs need no escape.
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
# Haptic Cushion: whoever sits at the machine may drive USB audio devices directly.
ACTION!="remove", SUBSYSTEM=="usb", ENV{DEVTYPE}=="usb_device", \
ENV{ID_USB_INTERFACES}=="*:0101??:*", TAG+="uaccess"
"""
"""Applies to devices of the audio class, recognised by their control interface."""

UDEV_COMMAND = (
    f"sudo tee {UDEV_PATH} >/dev/null <<'END'\n{UDEV_RULE}END\n"
    "sudo udevadm control --reload && "
    "sudo udevadm trigger --subsystem-match=usb --action=change\n"
)
"""The shell command that installs the rule as root."""


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
        told = subprocess.check_output(
            ["systemctl", "--version"],
            stdin=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=SYSTEMCTL_S,
        )
    except (OSError, subprocess.SubprocessError):
        return 0
    found = re.match(rb"systemd (\d{1,6})\b", told)
    return int(found[1]) if found else 0


def _unit_path(environ: Mapping[str, str]) -> Path:
    return _home(environ, "XDG_CONFIG_HOME", ".config") / "systemd" / "user" / NAME


def install(
    arguments: Sequence[str] = (),
    command: Sequence[str] | None = None,
    environ: Mapping[str, str] = os.environ,
    systemd: int = 0,
) -> Installed:
    """Write the unit that runs `cushion run` with these arguments; the commands start it.

    Makes missing folders, and writes the file atomically if its text differs. command: default
    `own_command`. systemd: `systemd_version`.

    UsageError: systemd does not accept a path or argument, a folder is not writable, or the unit
    was not written by this program.
    WriteError: the disk is full or failed.
    """
    installed_text(environ)  # refuses a unit of another program before a folder is made
    state = state_folder(environ)
    text = unit_text([*(command or own_command()), "run", *arguments], state, systemd)
    make_private_folder(state)
    return restore(text, environ)


def installed_text(environ: Mapping[str, str] = os.environ) -> str | None:
    """Return the text of the unit that `install` wrote, None without one. UsageError: as there."""
    path, text = _unit_path(environ), ""
    with suppress(OSError, UnicodeDecodeError):
        try:
            found = path.lstat()
        except (FileNotFoundError, NotADirectoryError):  # `install` reports NotADirectoryError
            return None
        if stat.S_ISREG(found.st_mode) and found.st_size <= UNIT_BYTES_MAX:
            text = path.read_text(encoding="utf-8")
    if not text.startswith(MARK):
        raise UsageError(
            f"{path} was not written by `cushion install-service` and is left alone; "
            "move it away first"
        )
    return text


def restore(text: str | None, environ: Mapping[str, str] = os.environ) -> Installed:
    """Write or remove the unit, as `installed_text` returned it. Errors: as for `install`."""
    if text is None:
        return remove(environ)
    path = _unit_path(environ)
    changed = installed_text(environ) != text
    if changed:
        make_private_folder(path.parent)
        write_bytes_atomically(path, text.encode())
    return Installed(path, changed, START)


def state_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """Return the folder of what this program keeps for itself. UsageError: there is no home."""
    return _home(environ, "XDG_STATE_HOME", ".local/state") / "cushion"


def remove(environ: Mapping[str, str] = os.environ) -> Installed:
    """Remove the unit that `install` wrote, if there is one.

    UsageError: the unit was not written by this program, or the folder is not writable.
    """
    path = _unit_path(environ)
    if installed_text(environ) is None:
        return Installed(path, False, ())
    try:
        path.unlink()
    except OSError as error:
        raise UsageError(f"cannot remove {path}: {error.strerror}; remove it yourself") from error
    return Installed(path, True, FORGET)


def _home(environ: Mapping[str, str], variable: str, otherwise: str) -> Path:
    text = environ.get(variable, "")
    # The XDG specification requires that relative paths be ignored.
    if text.startswith("/"):
        return Path(text)
    home = environ.get("HOME", "")
    if not home.startswith("/"):
        raise UsageError(f"neither {variable} nor HOME is an absolute path; set one of them")
    return Path(home) / otherwise
