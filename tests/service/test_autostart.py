"""The start at login: with systemd by a unit that is enabled, without it by the desktop."""

import configparser
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from audioflinger_hook.service import autostart
from audioflinger_hook.service.install import MARK, install
from device.errors import UsageError
from tests.support.recordings import ROOT

PROGRAM = [sys.executable, "-m", "audioflinger_hook"]
WANTED = "config/systemd/user/default.target.wants/cushion.service"
ENTRY = "config/autostart/cushion.desktop"


@pytest.fixture
def environ(tmp_path):
    folders = {f"XDG_{name.upper()}_HOME": str(tmp_path / name) for name in ("config", "data")}
    return {"HOME": str(tmp_path), "PATH": "/nowhere", **folders}


@pytest.fixture(params=["systemd", "without systemd"])
def started_by(request, tmp_path, monkeypatch):
    """Return the file that makes the daemon start at login."""
    booted = tmp_path / "booted"
    if request.param == "systemd":
        booted.mkdir()
    monkeypatch.setattr(autostart, "BOOTED", booted)
    return tmp_path / (WANTED if request.param == "systemd" else ENTRY)


def test_it_is_on_once_switched_on_and_off_once_switched_off(environ, started_by):
    assert not autostart.is_on(environ)
    for _ in range(2):
        autostart.set_on(True, environ, PROGRAM)
        assert autostart.is_on(environ)
        assert started_by.exists()
    for _ in range(2):
        autostart.set_on(False, environ, PROGRAM)
        assert not autostart.is_on(environ)
        assert not started_by.is_symlink()
        assert not started_by.exists()


@pytest.mark.parametrize("started_by", ["systemd"], indirect=True)
def test_systemd_itself_says_that_the_unit_is_enabled(environ, started_by, tmp_path):
    """`systemctl --root` reads a machine's folders; etc/systemd/user has the units of all users."""
    if shutil.which("systemctl") is None:
        pytest.skip("systemd is not installed")
    autostart.set_on(True, environ, PROGRAM)
    machine = tmp_path / "machine/etc/systemd"
    shutil.copytree(tmp_path / "config/systemd", machine, symlinks=True)
    command = ["systemctl", f"--root={tmp_path / 'machine'}", "--global", "is-enabled"]

    def told() -> str:
        done = subprocess.run([*command, "cushion"], capture_output=True, text=True, timeout=20)
        return done.stdout.strip()

    assert told() == "enabled"
    (machine / "user/default.target.wants/cushion.service").unlink()
    assert told() == "disabled"


@pytest.mark.parametrize("started_by", ["systemd"], indirect=True)
def test_a_unit_that_is_installed_keeps_its_options(environ, started_by):
    unit = install(["--wait", "--device", "sink:x"], PROGRAM, environ).path
    before = unit.read_text()
    autostart.set_on(True, environ, PROGRAM)
    autostart.set_on(False, environ, PROGRAM)
    assert unit.read_text() == before
    autostart.set_on(True, environ, PROGRAM)
    unit.unlink()
    assert not autostart.is_on(environ), "a link to nothing starts nothing"
    autostart.set_on(True, environ, PROGRAM)
    assert unit.read_text().startswith(MARK)


def test_a_machine_that_got_systemd_does_not_start_the_daemon_twice(environ, tmp_path, monkeypatch):
    monkeypatch.setattr(autostart, "BOOTED", tmp_path / "booted")
    autostart.set_on(True, environ, PROGRAM)
    (tmp_path / "booted").mkdir()
    assert autostart.is_on(environ)
    autostart.set_on(True, environ, PROGRAM)
    assert [(tmp_path / each).exists() for each in (WANTED, ENTRY)] == [True, False]


def test_what_another_program_wrote_stays(environ, started_by, tmp_path):
    for path in (tmp_path / ENTRY, tmp_path / "config/systemd/user/cushion.service"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("[Other]\n")
        with pytest.raises(UsageError, match="left alone; move it away first"):
            autostart.set_on(False, environ, PROGRAM)
        assert path.read_text() == "[Other]\n"
        path.unlink()


def test_a_folder_that_cannot_be_written_is_named(environ, started_by):
    started_by.parent.parent.mkdir(parents=True)
    started_by.parent.write_text("a file")
    with pytest.raises(UsageError, match=str(started_by.parent)):
        autostart.set_on(True, environ, PROGRAM)


def entry_at(path: Path) -> configparser.SectionProxy:
    parser = configparser.ConfigParser(interpolation=None)
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read(path, encoding="utf-8")
    return parser["Desktop Entry"]


def test_the_menu_has_an_entry_with_an_icon_that_opens_the_page(environ, tmp_path):
    entry = entry_at(autostart.install_page_entry(PROGRAM, environ))
    assert shlex.split(entry["Exec"]) == [*PROGRAM, "monitor", "--open"]
    icon = tmp_path / f"data/icons/hicolor/scalable/apps/{entry['Icon']}.svg"
    assert icon.read_bytes() == autostart.icon_bytes()
    autostart.remove_page_entry(environ)
    assert not any(path.is_file() for path in (tmp_path / "data").rglob("*"))


def test_the_packaged_entry_and_icon_are_the_program_s_and_words_are_quoted():
    share = ROOT / "share"
    assert (share / "applications/haptic-cushion.desktop").read_text() == autostart.page_entry()
    icon = share / "icons/hicolor/scalable/apps/haptic-cushion.svg"
    assert icon.read_bytes() == autostart.icon_bytes()
    assert autostart.exec_line(["/a/b", "100%"]) == "/a/b 100%%"
    assert autostart.exec_line(["/a b/c", "", "it's"]) == '"/a b/c" "" "it\'s"'
    assert autostart.exec_line(['$"`\\']) == r'"\\$\\"\\`\\\\"'
    with pytest.raises(UsageError, match="unprintable"):
        autostart.exec_line(["a\nb"])


def test_the_desktop_reads_the_command_as_it_was_written(tmp_path):
    glib = pytest.importorskip("gi.repository.GLib")
    words = ["/opt/a b", "$HOME", 'q"q', "back\\slash", "`x`", "é"]
    path = tmp_path / "x.desktop"
    path.write_text(f"[Desktop Entry]\nExec={autostart.exec_line(words)}\n")
    keys = glib.KeyFile()
    keys.load_from_file(str(path), glib.KeyFileFlags.NONE)
    assert glib.shell_parse_argv(keys.get_string("Desktop Entry", "Exec"))[1] == words
