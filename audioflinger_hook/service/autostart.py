"""Switches on and off whether the daemon starts at every login of this user.

With systemd, the user unit of `install` is enabled: the unit folder `default.target.wants` has a
link to the unit, as `systemctl --user enable` makes it. Without systemd, the desktop starts the
daemon, by an entry in the folder `autostart` of the config home.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from audioflinger_hook.service import install
from audioflinger_hook.service.desktop_entry import MARK, daemon_entry
from device.atomic_file import make_private_folder, remove_file
from device.errors import UsageError

BOOTED = Path("/run/systemd/system")  # exists if systemd started this machine
ENTRY_NAME = "cushion.desktop"


def has_systemd() -> bool:
    """Return whether systemd manages this machine, by the test of sd_booted(3)."""
    return BOOTED.is_dir()


def is_on(environ: Mapping[str, str] = os.environ) -> bool:
    """Return whether the daemon starts at the next login. Any thread may call it.

    UsageError: no home folder is known, or another program wrote the unit or the entry.
    """
    if install.own_text(_entry(environ), MARK):
        return True
    has_unit = has_systemd() and install.installed_text(environ) is not None
    return has_unit and _link(environ).is_symlink()


def set_on(
    on: bool, environ: Mapping[str, str] = os.environ, command: Sequence[str] | None = None
) -> None:
    """Switch the start at login on or off. A daemon that is running continues.

    An installed unit is kept, also when it is switched off. command: starts this program; by
    default `install.own_command()`. UsageError: a folder is not writable, another program wrote the
    unit or the entry, or systemd does not accept a path. WriteError: the disk is full or failed.
    """
    program = command or install.own_command()
    if on and not has_systemd():
        install.replace_own(_entry(environ), MARK, daemon_entry(program))
        return
    if install.installed_text(environ) is None and on:  # refuses a unit of another program
        install.install(["--wait"], program, environ, install.systemd_version())
    (_enable if on else remove_file)(_link(environ))
    install.replace_own(_entry(environ), MARK, None)  # so that the daemon does not start twice
    if has_systemd():  # a running user manager reads the units; the next login reads them, too
        install.printed(*install.RELOAD.split(), environ=environ)


def _entry(environ: Mapping[str, str]) -> Path:
    return install.home_folder(environ, "XDG_CONFIG_HOME", ".config") / "autostart" / ENTRY_NAME


def _link(environ: Mapping[str, str]) -> Path:
    return install.unit_path(environ).parent / "default.target.wants" / install.NAME


def _enable(link: Path) -> None:
    make_private_folder(link.parent)
    try:
        link.unlink(missing_ok=True)  # it may point to an older place
        link.symlink_to(Path("..", install.NAME))
    except OSError as error:
        raise UsageError(
            f"cannot write the link {link}: {error.strerror}; make the folder writable, or type "
            f"`systemctl --user enable {install.NAME}`"
        ) from error
