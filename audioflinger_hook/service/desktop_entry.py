"""Desktop entries, in the format of the freedesktop.org Desktop Entry Specification 1.5."""

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.resources import files
from pathlib import Path

from audioflinger_hook.service.install import home_folder, replace_own
from device.atomic_file import write_private
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


def daemon_entry(program: Sequence[str]) -> str:
    """Return the entry that starts the daemon at login on machines without systemd."""
    return _entry("Turns sound into vibration", [*program, "run", "--wait"], "NoDisplay=true\n")


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

    UsageError: a folder cannot be written, or another program wrote the entry. WriteError: the disk
    is full or failed.
    """
    entry, _ = _installed(environ)
    replace_own(entry, MARK, page_entry(program))
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
    replace_own(entry, MARK, None)
    with suppress(OSError):
        icon.unlink()
    return entry


def _installed(environ: Mapping[str, str]) -> tuple[Path, Path]:
    data = home_folder(environ, "XDG_DATA_HOME", ".local/share")
    icon = data / "icons/hicolor/scalable/apps" / f"{NAME}.svg"
    return data / "applications" / f"{NAME}.desktop", icon


def icon_bytes() -> bytes:
    """Return the icon as SVG."""
    return files("audioflinger_hook.monitor").joinpath("static", "icon.svg").read_bytes()
