"""What pages ask of a daemon that runs: checked as its config, applied, undone, saved."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from audioflinger_hook.config.edits import LiveEdits
from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.daemon import live_control
from audioflinger_hook.daemon.live_control import LiveControl
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.service.status_server import NAME
from audioflinger_hook.sources import TapAddress
from device.address import DeviceAddress
from tests.servers.listening import wait_for
from tests.support.commands import environment
from tests.support.recordings import ROOT

CONFIG = """# mine
gain_db = -3.0 # soft
"""


class Daemon:
    """`cushion run` of the demo's scene on the simulated cushion."""

    def __init__(self, folder: Path) -> None:
        self.config = folder / "config.toml"
        self.config.write_text(CONFIG)
        self._socket = folder / "cushion" / NAME
        self.process = subprocess.Popen(
            [
                *(sys.executable, "-m", "audioflinger_hook", "run", "--tap", "scene:demo"),
                *("--device", "twin", "--config", str(self.config), "--offset-ms", "20"),
            ],
            env=environment(XDG_RUNTIME_DIR=str(folder), PYTHONPATH=str(ROOT)),
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        try:
            wait_for(self._answers, "settings", 60.0)
        except BaseException:
            self.process.kill()
            self.process.communicate()
            raise

    def _answers(self) -> bool:
        # The socket's file exists a moment before the daemon listens on it.
        try:
            return bool(self.settings()["keys"])
        except (FileNotFoundError, ConnectionRefusedError):
            return False

    def _lines(self, request: dict[str, Any]) -> Iterator[Any]:
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(20.0)
            client.connect(str(self._socket))
            client.sendall(json.dumps({"protocol": 1, **request}).encode() + b"\n")
            with client.makefile("rb") as lines:
                for line in lines:
                    yield json.loads(line)

    def ask(self, **request: Any) -> Any:
        return next(self._lines({"ask": "control", **request}))

    def watch(self, kind: str) -> Any:
        lines = self._lines({"ask": "watch"})
        return next(line[kind] for line in lines if kind in line)

    def settings(self) -> Any:
        return self.watch("settings")

    def value(self, key: str) -> Any:
        return next(one for one in self.settings()["keys"] if one["key"] == key)["value"]


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    daemon = Daemon(tmp_path_factory.mktemp("run"))
    yield daemon
    assert daemon.process.poll() is None
    daemon.process.terminate()
    assert daemon.process.wait(20.0) == 130
    assert daemon.process.stderr is not None
    said = daemon.process.stderr.read()
    daemon.process.stderr.close()
    assert b"Traceback" not in said


def test_settings_come_with_the_schema_and_without_files_and_devices(daemon: Daemon) -> None:
    keys = {one["key"]: one for one in daemon.settings()["keys"]}
    gain = keys["gain_db"]
    assert gain["schema"] == {"type": "number", "minimum": -60.0, "maximum": 0.0}
    assert (gain["unit"], gain["meaning"]) == ("dB", "level of the vibration")
    assert keys["engine"]["schema"]["enum"] == ["auto", "native", "python"]
    assert not {"rig", "device", "tap", "effects_file"} & keys.keys()


def test_a_change_applies_at_once_and_the_file_changes_only_by_save(daemon: Daemon) -> None:
    assert daemon.ask(set={"gain_db": -9}) == {"done": True}
    assert daemon.value("gain_db") == -9
    assert daemon.config.read_text() == CONFIG
    assert daemon.settings()["unsaved"] == 1
    assert daemon.ask(save=True) == {"done": True}
    assert daemon.config.read_text() == CONFIG.replace("-3.0", "-9.0")
    assert daemon.ask(undo=True) == {"done": True}
    assert daemon.value("gain_db") == -3.0
    assert daemon.ask(save=True) == {"done": True}
    assert daemon.config.read_text() == CONFIG


def test_a_page_wins_over_an_option_until_it_is_undone(daemon: Daemon) -> None:
    assert daemon.value("offset_ms") == 20
    assert daemon.ask(set={"offset_ms": 5}) == {"done": True}
    assert daemon.value("offset_ms") == 5
    daemon.ask(undo=True)
    assert daemon.value("offset_ms") == 20


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"gain_db": 5}, "5 is out of range; allowed: -60 to 0 dB"),
        ({"gain_db": "loud"}, "loud is not a number; allowed: -60 to 0 dB"),
        ({"gain_db": True}, "True is not a number"),
        ({"profile": "cinma"}, "did you mean cinema?"),
        ({"offset_ms": -5}, "is below 0 without drop_in"),
        ({"gain": 1}, "did you mean gain_db?"),
        ({"rig": "/etc/passwd"}, "'rig' cannot be changed while the daemon runs"),
        ({"device": "hw:0"}, "'device' cannot be changed"),
        ({"transform.channels": "each"}, "cannot change while 'scene:demo' is in use"),
        ({}, "set takes 1 to 16 keys"),
        ([], "set takes 1 to 16 keys"),
        ({"gain_db": [[]] * 50}, "is not a number"),
    ],
)
def test_what_the_config_refuses_is_refused_in_its_words(
    daemon: Daemon, changes: Any, words: str
) -> None:
    before = daemon.settings()
    assert words in daemon.ask(set=changes)["error"]
    assert daemon.settings() == before


@pytest.mark.parametrize(
    "request_",
    [
        {},
        {"set": {"gain_db": 0}, "undo": True},
        {"mute": 1},
        {"application": 5, "felt": True},
        {"application": "x", "felt": None},
        {"application": " ", "felt": True},
        {"tone": {"hz": 5}},
        {"tone": {"hz": 60, "level": 2}},
        {"tone": {"hz": 60}},  # the simulated cushion plays none
    ],
)
def test_a_request_that_is_none_changes_nothing(daemon: Daemon, request_: dict[str, Any]) -> None:
    before = daemon.settings()
    assert daemon.ask(**request_)["error"]
    assert daemon.settings() == before


def test_mute_silences_and_is_not_saved(daemon: Daemon) -> None:
    assert daemon.ask(mute=True) == {"done": True}
    assert daemon.watch("status")["muted"]
    assert daemon.watch("frame")["level"] == 0.0
    daemon.ask(save=True)
    assert "mute" not in daemon.config.read_text()
    assert daemon.ask(mute=False) == {"done": True}
    assert not daemon.watch("status")["muted"]


def test_mute_works_while_the_file_has_mistakes_and_changes_nothing_else(daemon: Daemon) -> None:
    text, before = daemon.config.read_text(), daemon.value("gain_db")
    try:
        daemon.config.write_text(f"{text}profile = 7\n")
        assert "profile" in daemon.ask(set={"gain_db": -7.0})["error"]
        assert daemon.ask(mute=True) == {"done": True}
        assert daemon.settings()["muted"]
        daemon.config.write_text("gain_db = 0.0\n")
        assert daemon.ask(mute=False) == {"done": True}
        assert daemon.value("gain_db") == before
    finally:
        daemon.config.write_text(text)


@pytest.fixture
def control(tmp_path: Path) -> Iterator[LiveControl]:
    """What controls a daemon on a sink; nothing carries out its requests but `work`."""
    config = RunConfig(
        TapAddress("default"), DeviceAddress("sink", "a"), Settings(), LiveSettings()
    )
    supervisor = cast(Supervisor, SimpleNamespace(endpoints=(("default", "b"), ("sink:a", "a"))))
    edits = LiveEdits(tmp_path / "config.toml")
    made = LiveControl(supervisor, edits, lambda *_: config, lambda: None, config)
    yield made
    made.close()


def play(control: LiveControl, program: str) -> subprocess.Popen[bytes]:
    """Let a program be the test tone that plays, once it has said that it runs."""
    control._tone = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    assert control._tone.stdout is not None
    assert control._tone.stdout.readline() == b"on\n"
    control._tone.stdout.close()
    return control._tone


def test_a_tone_that_is_refused_leaves_the_one_that_plays(control: LiveControl) -> None:
    tone = play(control, "import time; print('on', flush=True); time.sleep(60)")
    refused = threading.Thread(target=control.control, args=({"tone": {"hz": 5}},))
    refused.start()
    while refused.is_alive():
        control.work()
    assert tone.poll() is None


def test_mute_ends_the_test_tone_as_well(control: LiveControl) -> None:
    tone = play(control, "import time; print('on', flush=True); time.sleep(60)")
    muting = threading.Thread(target=control.control, args=({"mute": True},))
    muting.start()
    while muting.is_alive():
        control.work()
    assert tone.poll() is not None


def test_a_tone_that_does_not_end_is_killed(
    control: LiveControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_control, "TONE_END_S", 0.1)
    ignore = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); "
    tone = play(control, f"{ignore}print('on', flush=True); time.sleep(10)")
    control.close()
    assert tone.returncode == -signal.SIGKILL


def test_a_file_that_cannot_be_written_is_told_and_nothing_is_lost(daemon: Daemon) -> None:
    daemon.ask(set={"gain_db": -12})
    text = daemon.config.read_text()
    kept = daemon.config.rename(daemon.config.with_name("kept.toml"))
    daemon.config.mkdir()
    error = daemon.ask(save=True)["error"]
    daemon.config.rmdir()
    kept.rename(daemon.config)
    assert "config.toml" in error
    assert daemon.settings()["unsaved"] == 1
    assert daemon.ask(undo=True) == {"done": True}
    assert daemon.config.read_text() == text
