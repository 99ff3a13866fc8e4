import configparser
import os
import shlex
import shutil
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from audioflinger_hook.service import autostart
from audioflinger_hook.service import install as units
from audioflinger_hook.service.install import FORGET, MARK, UDEV_PATH, install, own_command, restore
from device.errors import UsageError, WriteError
from device.stream.callback_thread import PRIORITY
from tests.support.recordings import ROOT

STATE = Path("/home/me/.local/state/cushion")
ANALYZE: Any = shutil.which("systemd-analyze")
needs_systemd = pytest.mark.skipif(ANALYZE is None, reason="systemd is not installed")


@pytest.fixture
def environ(tmp_path):
    return {"HOME": str(tmp_path)}


def line_of(text: str, key: str) -> str:
    (line,) = [line for line in text.splitlines() if line.startswith(f"{key}=")]
    return line.partition("=")[2]


def complaints(text: str, folder: Path) -> str:
    path = folder / "cushion.service"
    path.write_text(text)
    environ = {"PATH": os.environ["PATH"], "HOME": str(folder), "XDG_RUNTIME_DIR": str(folder)}
    command = [ANALYZE, "--user", "--man=no", "verify", str(path)]
    done = subprocess.run(command, env=environ, capture_output=True, text=True, timeout=30)
    # It names units of the machine, too.
    about = [line for line in done.stderr.splitlines() if "cushion" in line]
    return "\n".join(about) or ("" if done.returncode == 0 else done.stderr)


@needs_systemd
def test_systemd_has_nothing_to_say_about_the_unit(tmp_path, environ):
    version = units.systemd_version()
    assert version > 200
    path = install([], [sys.executable], environ, version).path
    assert complaints(path.read_text(), tmp_path) == ""
    text = units.unit_text((sys.executable, "-m", "audioflinger_hook", "run"), STATE)
    assert complaints(text, tmp_path) == ""
    assert "Nonsense" in complaints(text.replace("UMask=", "Nonsense="), tmp_path)


@needs_systemd
def test_systemd_understands_every_name_and_argument(tmp_path):
    program = tmp_path / "its 100% $HOME; a b" / "cushion"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    arguments = ("--config", "a \"b\" \\ $X ${Y} %h 'c'", ";", "", "é", "--offset-ms=-5")
    text = units.unit_text((str(program), *arguments), tmp_path / "st ate %h $X")
    assert complaints(text, tmp_path) == ""
    assert "not executable" in complaints(text.replace("; a b", "; a c"), tmp_path)


def test_the_command_is_quoted_and_a_newer_systemd_sends_the_signal_to_reload_itself():
    text = units.unit_text(("/opt/a b/100%/$x/cushion", "run", '$HOME %h "q" b\\s'), Path("/s %h"))
    quoted = '"/opt/a b/100%%/$x/cushion" "run" "$$HOME %%h \\"q\\" b\\\\s"'
    assert (line_of(text, "ExecStart"), line_of(text, "ReadWritePaths")) == (quoted, '"-/s %%h"')
    assert line_of(text, "ExecReload") == "/bin/kill -HUP $MAINPID"
    old, new = (units.unit_text(("/cushion", "run"), STATE, systemd) for systemd in (252, 253))
    assert (old, line_of(old, "Type")) == (units.unit_text(("/cushion", "run"), STATE), "notify")
    assert "ReloadSignal" not in old
    assert (line_of(new, "Type"), line_of(new, "ReloadSignal")) == ("notify-reload", "SIGHUP")
    assert "ExecReload" not in new


def test_without_systemd_its_version_is_0(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert units.systemd_version() == 0
    program = tmp_path / "systemctl"
    for text, version in (("systemd 254 (254.1)", 254), ("something else", 0), ("", 0)):
        program.write_text(f"#!/bin/sh\necho '{text}'\n")
        program.chmod(0o755)
        assert units.systemd_version() == version


def test_wrong_config_stays_wrong_and_audio_threads_have_room_and_bounds():
    text = units.unit_text(("/cushion", "run"), STATE)
    assert line_of(text, "RestartPreventExitStatus") == "2 3"
    assert (line_of(text, "LimitRTPRIO"), line_of(text, "LimitRTTIME")) == ("20", "200ms:2s")
    assert int(line_of(text, "LimitRTPRIO")) >= PRIORITY
    assert line_of(text, "RestrictAddressFamilies") == "AF_UNIX AF_NETLINK"
    # Neither the sound cards nor real-time priority may be out of reach.
    assert not any(line.startswith(("PrivateDevices", "RestrictRealtime")) for line in text.split())


@pytest.mark.parametrize(
    "command",
    [
        *(("cushion",), ("./cushion",), ('/a"b/cushion',), ("/a'b/cushion",), ("/a\\b/cushion",)),
        *(("/a\nb/cushion",), ("/a\udc80/cushion",), ("/cushion", "\x07")),
        ("/cushion", "a\nExecStartPre=/bin/evil"),
    ],
)
def test_what_systemd_cannot_take_is_refused(command):
    with pytest.raises(UsageError, match="systemd"):
        units.unit_text(command, STATE)
    for folder in ('/a"b', "/a\\b", "/a\nb"):
        with pytest.raises(UsageError, match="systemd cannot use"):
            units.unit_text(("/cushion",), Path(folder))


def test_the_unit_is_written_whole_where_systemd_looks_if_new_and_removed_alone(environ, tmp_path):
    done = install(["--tap", "sink:a b"], ["/opt/cushion"], environ)
    assert done.path == tmp_path / ".config/systemd/user/cushion.service"
    assert (done.changed, done.commands) == (True, units.START)
    text = done.path.read_text()
    assert text.startswith(MARK)
    assert line_of(text, "ExecStart") == '"/opt/cushion" "run" "--tap" "sink:a b"'
    state = tmp_path / ".local/state/cushion"
    assert stat.S_IMODE(state.stat().st_mode) == 0o700
    assert line_of(text, "ReadWritePaths") == f'"-{state}"'
    inode = done.path.stat().st_ino
    assert not install(["--tap", "sink:a b"], ["/opt/cushion"], environ).changed
    assert done.path.stat().st_ino == inode
    assert install([], ["/opt/cushion"], environ).changed
    assert [path.name for path in done.path.parent.iterdir()] == ["cushion.service"]
    other = done.path.with_name("other.service")
    other.touch()
    removed = restore(None, environ)
    assert (removed.path, removed.changed, removed.commands) == (done.path, True, FORGET)
    assert list(other.parent.iterdir()) == [other]
    assert not restore(None, environ).changed


def test_the_config_and_state_homes_are_respected_and_wrong_ones_are_not(tmp_path):
    environ = {"HOME": str(tmp_path / "home"), "XDG_STATE_HOME": "relative"}
    done = install([], ["/opt/cushion"], environ | {"XDG_CONFIG_HOME": str(tmp_path / "config")})
    assert done.path == tmp_path / "config/systemd/user/cushion.service"
    assert (tmp_path / "home/.local/state/cushion").is_dir()
    with pytest.raises(UsageError, match="neither XDG_CONFIG_HOME nor HOME"):
        install([], ["/opt/cushion"], {})
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="cannot make the folder"):
        install([], ["/opt/cushion"], environ | {"XDG_CONFIG_HOME": str(tmp_path / "file")})


@pytest.mark.parametrize("kind", ["edited", "binary", "masked", "folder", "huge"])
def test_a_unit_that_somebody_else_wrote_stays(environ, tmp_path, kind):
    path = tmp_path / ".config/systemd/user/cushion.service"
    path.parent.mkdir(parents=True)
    if kind == "masked":
        path.symlink_to("/dev/null")
    elif kind == "folder":
        path.mkdir()
    else:
        content = {"edited": b"[Service]\n", "binary": b"\xff", "huge": MARK.encode() * 10_000}
        path.write_bytes(content[kind])
    before = path.lstat()
    for change in (lambda: install([], ["/opt/cushion"], environ), lambda: restore(None, environ)):
        with pytest.raises(UsageError, match="is left alone; move it away first"):
            change()
    assert os.path.samestat(path.lstat(), before)


def test_a_disk_that_is_full_leaves_the_unit_as_it_was(environ, monkeypatch):
    path = install([], ["/opt/cushion"], environ).path
    before = path.read_text()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(WriteError, match="the disk is full"):
        install(["--profile", "x"], ["/opt/cushion"], environ)
    assert path.read_text() == before


def test_the_program_that_runs_is_the_one_that_is_installed(tmp_path):
    script = tmp_path / "cushion"
    script.write_text("#!/bin/sh\n")
    python = (sys.executable, "-m", "audioflinger_hook")
    assert own_command(str(script), sys.executable) == python  # not executable
    script.chmod(0o755)
    assert own_command(str(script), sys.executable) == (str(script),)
    assert own_command("/x/audioflinger_hook/__main__.py", sys.executable) == python
    link = tmp_path / "venv" / "cushion"
    link.parent.mkdir()
    link.symlink_to(script)
    assert own_command(str(link), sys.executable) == (str(link),)


def test_the_command_installs_the_rule_as_it_is(tmp_path):
    target = tmp_path / "70-cushion.rules"
    # it only does the writing, elsewhere
    sudo = f'sudo() {{ if [ "$1" = tee ]; then cat > "{target}"; else echo "$*"; fi; }}\n'
    command = ["sh", "-c", sudo + units.UDEV_COMMAND]
    done = subprocess.run(command, capture_output=True, text=True, timeout=10)
    assert int(Path(UDEV_PATH).name[:2]) < 73  # the rule that gives access away
    assert target.read_text() == units.UDEV_RULE
    said = "udevadm control --reload\nudevadm trigger --subsystem-match=usb --action=change\n"
    assert (done.stdout, done.stderr) == (said, "")


PROGRAM = [sys.executable, "-m", "audioflinger_hook"]
WANTED = "config/systemd/user/default.target.wants/cushion.service"
ENTRY = "config/autostart/cushion.desktop"


@pytest.fixture
def homes(tmp_path):
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


def test_it_is_on_once_switched_on_and_off_once_switched_off(homes, started_by):
    assert not autostart.is_on(homes)
    for wanted in (True, True, False, False):
        autostart.set_on(wanted, homes, PROGRAM)
        assert autostart.is_on(homes) == os.path.lexists(started_by) == wanted
        assert started_by.exists() == wanted


@pytest.mark.parametrize("started_by", ["systemd"], indirect=True)
def test_systemd_itself_says_that_the_unit_is_enabled(homes, started_by, tmp_path):
    """`systemctl --root` reads a machine's folders; etc/systemd/user has the units of all users."""
    if shutil.which("systemctl") is None:
        pytest.skip("systemd is not installed")
    autostart.set_on(True, homes, PROGRAM)
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
def test_a_unit_that_is_installed_keeps_its_options(homes, started_by):
    unit = install(["--wait", "--device", "sink:x"], PROGRAM, homes).path
    before = unit.read_text()
    autostart.set_on(True, homes, PROGRAM)
    autostart.set_on(False, homes, PROGRAM)
    assert unit.read_text() == before
    autostart.set_on(True, homes, PROGRAM)
    unit.unlink()
    assert not autostart.is_on(homes), "a link to nothing starts nothing"
    autostart.set_on(True, homes, PROGRAM)
    assert unit.read_text().startswith(MARK)


def test_a_machine_that_got_systemd_does_not_start_the_daemon_twice(homes, tmp_path, monkeypatch):
    monkeypatch.setattr(autostart, "BOOTED", tmp_path / "booted")
    autostart.set_on(True, homes, PROGRAM)
    (tmp_path / "booted").mkdir()
    assert autostart.is_on(homes)
    autostart.set_on(True, homes, PROGRAM)
    assert [(tmp_path / each).exists() for each in (WANTED, ENTRY)] == [True, False]


def test_what_another_program_wrote_stays_and_a_folder_not_to_be_written_is_named(
    homes, started_by, tmp_path
):
    for path in (tmp_path / ENTRY, tmp_path / "config/systemd/user/cushion.service"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("[Other]\n")
        with pytest.raises(UsageError, match="left alone; move it away first"):
            autostart.set_on(False, homes, PROGRAM)
        assert path.read_text() == "[Other]\n"
        path.unlink()
    started_by.parent.parent.mkdir(parents=True, exist_ok=True)
    if started_by.parent.is_dir():
        started_by.parent.rmdir()
    started_by.parent.write_text("a file")
    with pytest.raises(UsageError, match=str(started_by.parent)):
        autostart.set_on(True, homes, PROGRAM)


def entry_at(path: Path) -> configparser.SectionProxy:
    parser = configparser.ConfigParser(interpolation=None)
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read(path, encoding="utf-8")
    return parser["Desktop Entry"]


def test_the_menu_has_an_entry_with_an_icon_that_opens_the_page(homes, tmp_path):
    entry = entry_at(autostart.install_page_entry(PROGRAM, homes))
    assert shlex.split(entry["Exec"]) == [*PROGRAM, "monitor", "--open"]
    icon = tmp_path / f"data/icons/hicolor/scalable/apps/{entry['Icon']}.svg"
    assert icon.read_bytes() == autostart.icon_bytes()
    autostart.remove_page_entry(homes)
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
