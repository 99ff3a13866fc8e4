import math
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from audioflinger_hook.config.edits import LiveEdits
from audioflinger_hook.daemon import live_control
from audioflinger_hook.daemon.live_control import PAUSE_S, LiveControl
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.service.request_queue import WAITING_MAX
from tests.service.test_watch import Client
from tests.support.commands import start, until
from tests.support.run_configs import config

CONFIG = "# mine\ngain_db = -3.0 # soft\n"
JUNK: list[Any] = ["junk", 60, [], {"x": 1}, False, None]


class Daemon:
    def __init__(self, folder: Path) -> None:
        self.config = folder / "config.toml"
        self.config.write_text(CONFIG)
        self._folder = folder / "cushion"
        options = ("--tap", "scene:demo", "--device", "twin", "--config", self.config)
        env = {"XDG_RUNTIME_DIR": str(folder)}
        self.process = start("run", *options, "--offset-ms", 20, env=env)
        until(self._answers, self.process)

    def _answers(self) -> bool:
        # The socket's file exists a moment before the daemon listens on it.
        with suppress(FileNotFoundError, ConnectionRefusedError):
            return bool(self.settings()["keys"])
        return False

    def ask(self, **request: Any) -> Any:
        with Client(self._folder, ask="control", **request) as client:
            return client.next()

    def watch(self, kind: str) -> Any:
        with Client(self._folder, ask="watch") as client:
            return client.next_with(kind)

    def settings(self) -> Any:
        return self.watch("settings")

    def shown(self, key: str) -> Any:
        return next(one for one in self.settings()["keys"] if one["key"] == key)

    def value(self, key: str) -> Any:
        return self.shown(key)["value"]

    def reason_at(self, offset_ms: float) -> str:
        for _ in range(50):
            if (found := self.watch("status"))["offset_ms"] == offset_ms:
                return str(found["offset_reason"])
        raise AssertionError(found)


@pytest.fixture(scope="module")
def daemon(tmp_path_factory):
    daemon = Daemon(tmp_path_factory.mktemp("run"))
    yield daemon
    assert daemon.process.poll() is None
    daemon.process.terminate()
    _, said = daemon.process.communicate(timeout=20.0)
    assert daemon.process.returncode == 130
    assert "Traceback" not in said


def test_settings_come_with_the_schema_and_without_files_and_devices(daemon):
    keys = {one["key"]: one for one in daemon.settings()["keys"]}
    gain = keys["gain_db"]
    assert gain["schema"] == {"type": "number", "minimum": -60.0, "maximum": 0.0}
    assert (gain["unit"], gain["meaning"]) == ("dB", "level of the vibration")
    assert keys["engine"]["schema"]["enum"] == ["auto", "native", "python"]
    assert not {"rig", "device", "tap", "effects_file"} & keys.keys()


def test_a_change_applies_at_once_and_the_file_changes_only_by_save(daemon):
    assert (daemon.ask(set={"gain_db": -9}), daemon.value("gain_db")) == ({"done": True}, -9)
    assert (daemon.config.read_text(), daemon.settings()["unsaved"]) == (CONFIG, 1)
    assert daemon.ask(save=True) == {"done": True}
    assert daemon.config.read_text() == CONFIG.replace("-3.0", "-9.0")
    assert (daemon.ask(undo=True), daemon.value("gain_db")) == ({"done": True}, -3.0)
    assert (daemon.ask(save=True), daemon.config.read_text()) == ({"done": True}, CONFIG)
    assert daemon.value("offset_ms") == 20  # of an option, which a page wins over
    assert (daemon.ask(set={"offset_ms": 5}), daemon.value("offset_ms")) == ({"done": True}, 5)
    daemon.ask(undo=True)
    assert daemon.value("offset_ms") == 20


def test_an_unsaved_value_comes_with_what_the_file_says(daemon):
    assert daemon.ask(set={"gain_db": -9, "profile": "music"}) == {"done": True}
    gain, profile = daemon.shown("gain_db"), daemon.shown("profile")
    assert (gain["value"], gain["unsaved"], gain["file"]) == (-9, True, -3.0)
    assert (profile["unsaved"], profile["file"]) == (True, None)
    assert daemon.ask(set={"gain_db": -3, "profile": None}) == {"done": True}
    assert not daemon.shown("gain_db")["unsaved"]
    assert daemon.settings()["unsaved"] == 0
    for _ in range(2):
        assert daemon.ask(undo=True) == {"done": True}


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
        *(({}, "set takes 1 to 16 keys"), ([], "set takes 1 to 16 keys")),
        ({"gain_db": [[]] * 50}, "is not a number"),
    ],
)
def test_what_the_config_refuses_is_refused_in_its_words(daemon, changes, words):
    before = daemon.settings()
    assert words in daemon.ask(set=changes)["error"]
    assert daemon.settings() == before


@pytest.mark.parametrize(
    "request_",
    [
        *({}, {"set": {"gain_db": 0}, "undo": True}, {"mute": 1}, {"mute": True, "x": 1}),
        *({"undo": value} for value in JUNK),
        *({"save": value} for value in JUNK),
        {"application": {"match": "\ud800", "feel": True}},
        *({"application": "x", "felt": True}, {"application": {"match": "x"}}),
        {"application": {"match": 5, "feel": True}},
        {"application": {"match": " ", "feel": True}},
        {"application": {"match": "x", "feel": 1}},
        {"application": {"match": "x", "feel": False, "profile": "game"}},
        {"application": {"match": "x", "profile": "nix"}},
        {"application": {"match": "x", "gain_db": 3}},
        {"application": {"match": "x", "level": 3}},
        {"application": {"match": "x", "profile": [["game"]]}},
        *({"application": {"match": "x", "feel": {"a": 1}}}, {"tone": {"hz": 5}}),
        {"tone": {"hz": 60, "level": 2}},
        {"tone": {"hz": 60}},  # the simulated cushion plays none
        *({"sync": 5}, {"sync": {}}, {"sync": {"try_ms": 5, "store_ms": 5}}, {"sync": {"try": 5}}),
        *({"sync": {"try_ms": "auto"}}, {"sync": {"try_ms": True}}, {"sync": {"try_ms": 1e9}}),
        {"sync": {"try_ms": -5}},  # without drop-in mode
        {"sync": {"store_ms": None}},
        {"sync": {"store_ms": 5}},  # this run has no two sinks
    ],
)
def test_a_request_that_is_none_changes_nothing(daemon, request_):
    before = daemon.settings()
    assert daemon.ask(**request_)["error"]
    assert daemon.settings() == before


def test_a_rule_of_an_application_applies_is_undone_and_goes_to_the_file_only_by_save(daemon):
    def rule(**values):
        return daemon.ask(application={"match": "Film", **values})

    def rules():
        settings = daemon.settings()
        said = [{n: v for n, v in one.items() if v not in (None, 0.0)} for one in settings["rules"]]
        return said, settings["unsaved_rules"]

    refused = rule(profile="cinma")  # in the words of the config
    assert refused["key"] == "application:Film"
    assert 'application[1].profile = "cinma" is not known' in refused["error"]
    assert "did you mean cinema?" in refused["error"]
    assert (rules(), rule(profile="game")) == (([], []), {"done": True})
    assert rules() == ([{"match": "Film", "profile": "game"}], ["Film"])
    assert rule(gain_db=-3) == {"done": True}
    assert rules()[0] == [{"match": "Film", "profile": "game", "gain_db": -3.0}]
    assert (daemon.config.read_text(), daemon.ask(save=True)) == (CONFIG, {"done": True})
    saved = f'{CONFIG}\n[[application]]\nmatch = "Film"\nprofile = "game"\ngain_db = -3\n'
    assert (daemon.config.read_text(), rules()[1]) == (saved, [])
    assert daemon.ask(application={"match": "film ", "feel": False}) == {"done": True}
    assert (rules(), daemon.settings()["unsaved"]) == (([{"match": "Film"}], ["Film"]), 1)
    assert (rule(feel=True), rules()[0]) == ({"done": True}, [{"match": "Film", "feel": True}])
    assert (rule(feel=None), rules()) == ({"done": True}, ([], ["Film"]))
    for _ in range(3):
        assert daemon.ask(undo=True) == {"done": True}
    assert rules()[1] == []
    for _ in range(2):
        assert daemon.ask(undo=True) == {"done": True}
    assert (rules(), daemon.ask(save=True)) == (([], ["Film"]), {"done": True})
    assert daemon.config.read_text() == CONFIG


def test_the_mixed_sound_leaves_an_application_out_by_a_capture_of_the_others(control):
    control._supervisor.is_mixed = True
    asked = control._carry_out({"application": {"match": "Film", "feel": False}})
    assert (asked, control._edits.values) == ({"done": True}, {"applications.exclude": ("Film",)})
    control._supervisor.is_mixed = False
    control._carry_out({"application": {"match": "Film", "feel": True}})
    assert control._edits.values["application:Film"] == {"feel": True}


def test_an_offset_on_trial_plays_and_is_none_of_the_config_but_auto_is(daemon):
    assert daemon.ask(sync={"try_ms": 120}) == {"done": True}
    assert (daemon.reason_at(120.0), daemon.value("offset_ms")) == ("set in the config", 20)
    assert (daemon.settings()["unsaved"], daemon.ask(sync={"try_ms": None})) == (0, {"done": True})
    assert daemon.reason_at(20.0) == "set in the config"
    assert daemon.ask(set={"offset_ms": "auto"}) == {"done": True}
    assert (daemon.value("offset_ms"), daemon.reason_at(0.0)) == ("auto", "not known")
    daemon.ask(undo=True)
    assert daemon.value("offset_ms") == 20


def test_mute_silences_is_not_saved_and_works_while_the_file_has_mistakes(daemon):
    assert daemon.ask(mute=True) == {"done": True}
    assert daemon.watch("status")["muted"]
    assert daemon.watch("frame")["level"] == 0.0
    daemon.ask(save=True)
    assert "mute" not in daemon.config.read_text()
    assert daemon.ask(mute=False) == {"done": True}
    assert not daemon.watch("status")["muted"]
    text, before = daemon.config.read_text(), daemon.value("gain_db")
    try:
        daemon.config.write_text(f"{text}profile = 7\n")
        assert "profile" in daemon.ask(set={"gain_db": -7.0})["error"]
        assert daemon.ask(mute=True) == {"done": True}
        assert daemon.settings()["muted"]
        daemon.config.write_text("gain_db = 0.0\n")
        assert (daemon.ask(mute=False), daemon.value("gain_db")) == ({"done": True}, before)
    finally:
        daemon.config.write_text(text)


@pytest.fixture
def control(tmp_path):
    """What controls a daemon on a sink; nothing carries out its requests but `work`."""
    order = config("sink:a")
    supervisor = cast(Supervisor, SimpleNamespace(endpoints=(("default", "b"), ("sink:a", "a"))))
    edits = LiveEdits(tmp_path / "config.toml")
    made = LiveControl(supervisor, edits, lambda *_: order, lambda: None, order)
    yield made
    made.close()


def play(control: LiveControl, program: str) -> subprocess.Popen[bytes]:
    """Let a program be the test tone that plays, once it has said that it runs."""
    control._tone = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    assert control._tone.stdout is not None
    assert control._tone.stdout.readline() == b"on\n"
    control._tone.stdout.close()
    return control._tone


@pytest.mark.parametrize(("asked", "ends"), [({"tone": {"hz": 5}}, False), ({"mute": True}, True)])
def test_mute_ends_the_test_tone_as_well_and_a_tone_that_is_refused_does_not(control, asked, ends):
    tone = play(control, "import time; print('on', flush=True); time.sleep(60)")
    asking = threading.Thread(target=control.control, args=(asked,))
    asking.start()
    while asking.is_alive():
        control.work(0.0)
    assert (tone.poll() is not None) == ends


@pytest.mark.parametrize("wanted", ["junk", True, 60, {"Hz": 60}, {"hz": math.nan}, {"level": 1}])
def test_only_a_tone_as_documented_is_played(control, monkeypatch, wanted):
    monkeypatch.setattr(subprocess, "Popen", None)
    answer = control._carry_out({"tone": wanted})
    assert answer["key"] == "tone"
    assert "tone takes" in answer["error"] or "out of range" in answer["error"]


def test_a_flood_of_values_is_carried_out_at_a_limited_rate_and_the_last_wins(control, monkeypatch):
    done: list[object] = []

    def carry_out(asked: object) -> dict[str, Any]:
        done.append(asked)
        return {"done": True}

    monkeypatch.setattr(control, "_carry_out", carry_out)
    answers: list[Any] = []

    def ask(**request: Any) -> None:
        control._waiting.put(request, answers.append)

    for number in range(50):
        ask(set={"gain_db": -number})
        ask(set={"offset_ms": number})
        ask(mute=number % 2 == 0)
    assert answers == [{"done": True}] * 147
    ask(undo=True)  # its effect depends on the values before
    ask(set={"gain_db": -60})
    assert control.rest_s(5.0) == 0.0
    for now_s in (5.0, 5.0 + 0.9 * PAUSE_S, 5.0 + PAUSE_S):
        control.work(now_s)
    assert control.rest_s(5.0 + PAUSE_S) == pytest.approx(PAUSE_S)
    assert done == [{"set": {"gain_db": -49}}, {"set": {"offset_ms": 49}}]
    for number in range(3):
        control.work(6.0 + number)
    assert done[2:] == [{"mute": False}, {"undo": True}, {"set": {"gain_db": -60}}]
    assert (control.rest_s(9.0), len(answers)) == (math.inf, 152)
    for _ in range(WAITING_MAX + 1):
        ask(undo=True)
    assert "too many requests" in answers[-1]["error"]


def test_a_tone_that_does_not_end_is_killed(control, monkeypatch):
    monkeypatch.setattr(live_control, "TONE_END_S", 0.1)
    ignore = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); "
    tone = play(control, f"{ignore}print('on', flush=True); time.sleep(10)")
    control.close()
    assert tone.returncode == -signal.SIGKILL


def test_a_file_that_cannot_be_written_is_told_and_nothing_is_lost(daemon):
    daemon.ask(set={"gain_db": -12})
    text = daemon.config.read_text()
    kept = daemon.config.rename(daemon.config.with_name("kept.toml"))
    daemon.config.mkdir()
    error = daemon.ask(save=True)["error"]
    daemon.config.rmdir()
    kept.rename(daemon.config)
    assert "config.toml" in error
    assert (daemon.settings()["unsaved"], daemon.ask(undo=True)) == (1, {"done": True})
    assert daemon.config.read_text() == text
