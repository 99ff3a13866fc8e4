"""The application menu's entry, and the start of the daemon at every login of this user.

With systemd, the user unit of `install` is enabled: the unit folder `default.target.wants` has a
link to the unit, as `systemctl --user enable` makes it. Without systemd, the desktop starts the
daemon, by an entry in the folder `autostart` of the config home. Entries have the format of the
freedesktop.org Desktop Entry Specification 1.5.
"""

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.resources import files
from pathlib import Path

from audioflinger_hook.service import install
from device.atomic_file import make_private_folder, remove_file, write_private
from device.errors import UsageError

NAME = "haptic-cushion"  # name of the icon and, with .desktop, of the menu's entry
MARK = "# Written by `cushion`."  # first line of every entry of this program


def exec_line(command: Sequence[str]) -> str:
    """Return a command as the value of the key Exec. UsageError: a word has a control character."""
    return " ".join(map(_word, command))


def _word(word: str) -> str:
    if not word.isprintable():
        raise UsageError(
            f"a desktop entry cannot hold {word!r}, which has an unprintable character; "
            "install the program in another folder"
        )
    word = word.replace("%", "%%")
    if re.fullmatch(r"[\w@%+=:,./-]+", word, re.ASCII):
        return word
    # Values of this format have a second level of escapes.
    return '"' + re.sub(r'(["`$\\])', r"\\\1", word).replace("\\", "\\\\") + '"'


def page_entry(program: Sequence[str] = ("cushion",)) -> str:
    """Return the entry of the application menu, which opens the live page."""
    return _entry(
        "Feel what this computer plays",
        [*program, "monitor", "--open"],
        """\
GenericName=Sound to vibration
Categories=AudioVideo;Audio;
Keywords=haptics;vibration;shaker;bass;
""",
    )


def _entry(comment: str, command: Sequence[str], more: str) -> str:
    return f"""\
{MARK}
[Desktop Entry]
Type=Application
Name=Haptic Cushion
Comment={comment}
Exec={exec_line(command)}
Icon={NAME}
Terminal=false
{more}"""


def install_page_entry(program: Sequence[str], environ: Mapping[str, str] = os.environ) -> Path:
    """Write the menu's entry and its icon for this user; return the path of the entry.

    UsageError: no writable folder, or a foreign entry. WriteError: the disk is full or failed.
    """
    entry, _ = _installed(environ)
    install.replace_own(entry, MARK, page_entry(program))
    install_icon(environ)
    return entry


def install_icon(environ: Mapping[str, str] = os.environ) -> Path:
    """Write the icon; return the folder of icon themes. Errors: see `install_page_entry`."""
    _, icon = _installed(environ)
    write_private(icon, icon_bytes())
    return icon.parents[3]


def remove_page_entry(environ: Mapping[str, str] = os.environ) -> Path:
    """Remove the menu's entry and its icon; return the entry's path. Errors: see `own_text`."""
    entry, icon = _installed(environ)
    install.replace_own(entry, MARK, None)
    with suppress(OSError):
        icon.unlink()
    return entry


def _installed(environ: Mapping[str, str]) -> tuple[Path, Path]:
    data = install.home_folder(environ, "XDG_DATA_HOME", ".local/share")
    icon = data / "icons/hicolor/scalable/apps" / f"{NAME}.svg"
    return data / "applications" / f"{NAME}.desktop", icon


def icon_bytes() -> bytes:
    """Return the icon as SVG."""
    return files("audioflinger_hook.monitor").joinpath("static", "icon.svg").read_bytes()


BOOTED = Path("/run/systemd/system")  # exists if systemd started this machine
ENTRY_NAME = "cushion.desktop"


def has_systemd() -> bool:
    """Return whether systemd manages this machine, by the test of sd_booted(3)."""
    return BOOTED.is_dir()


def is_on(environ: Mapping[str, str] = os.environ) -> bool:
    """Return whether the daemon starts at the next login. Any thread may call it.

    UsageError: no home folder is known, or another program wrote the unit or the entry.
    """
    if install.own_text(_login_entry(environ), MARK):
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
        command = [*program, "run", "--wait"]
        entry = _entry("Turns sound into vibration", command, "NoDisplay=true\n")
        install.replace_own(_login_entry(environ), MARK, entry)
        return
    if install.installed_text(environ) is None and on:  # refuses a unit of another program
        install.install(["--wait"], program, environ, install.systemd_version())
    (_enable if on else remove_file)(_link(environ))
    install.replace_own(_login_entry(environ), MARK, None)  # it must not start twice
    if has_systemd():  # a running user manager reads the units; the next login reads them, too
        install.printed(*install.RELOAD.split(), environ=environ)


def _login_entry(environ: Mapping[str, str]) -> Path:
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
