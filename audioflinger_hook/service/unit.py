"""The systemd user unit and the udev rule, as text."""

from __future__ import annotations

import string
from collections.abc import Sequence
from pathlib import Path

from audioflinger_hook.service.one_line import one_line
from device.errors import UsageError

NAME = "cushion.service"
MARK = "# Written by `cushion install-service`."
"""Beginning of every unit that this program wrote."""

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

    state_folder: the daemon may write here and in the runtime folder. systemd: its version; 0: a
    unit for any version.

    UsageError: systemd does not accept a path or argument.
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
        raise UsageError(
            f"systemd cannot use {one_line(text)!r}: it has unprintable characters; "
            "choose another name"
        )
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
