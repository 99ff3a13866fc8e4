"""`cushion sync` at a terminal, with real clicks on a real server, and what the daemon is asked."""

import json
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.service.meters import Level
from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import Endpoint, Levels
from audioflinger_hook.service.sync_trials import Answer, SimulatedPerson, SyncTrials
from tests.monitor import stand_in
from tests.monitor.stand_in import STATUS, daemon_socket
from tests.servers.daemons import environment, running
from tests.servers.listening import arriving, onsets, recording, wait_for, wait_seconds
from tests.support.terminal import Terminal

on_pulse = pytest.mark.parametrize("server", ["pulse"], indirect=True)

CTRL_C, CTRL_D = b"\x03", b"\x04"
LEFT, RIGHT = b"\x1b[D", b"\x1b[C"
KEYS = {Answer.FELT_FIRST: LEFT, Answer.HEARD_FIRST: RIGHT, Answer.TOGETHER: b" "}
LETTERS = {Answer.FELT_FIRST: b"f", Answer.HEARD_FIRST: b"H", Answer.TOGETHER: b"t"}
END = {"sync": {"try_ms": None}}


def asked(live):
    return [{"sync": request["sync"]} for request in live.requests]


@contextmanager
def at_a_terminal(server, *options):
    """A daemon's socket, and a test that waits for the first key."""
    folder = Path(server.environment["XDG_RUNTIME_DIR"])
    with (
        daemon_socket(folder) as live,
        Terminal("sync", *options, env=environment(server)) as terminal,
    ):
        yield live, terminal


def answered(terminal, on_trial, person, keys, stop_at=None):
    """Answer the clicks as this person until the trials are over; return the trials.

    The same trials are run here, so the offset of each is known; on_trial: called with it.
    """
    trials = SyncTrials(0.0)
    while not trials.is_over(0.0) and trials.count != stop_at:
        offset_ms = trials.next_ms()
        terminal.expect(f"click {trials.count + 1}: ")
        on_trial(offset_ms)
        answer = person.answer(offset_ms)
        terminal.press(keys[answer])
        terminal.expect(answer.value)
        trials.add(offset_ms, answer)
    return trials


def was_asked(live):
    """Return what `answered` calls: the daemon's last request was to try the offset."""

    def check(offset_ms):
        assert asked(live)[-1] == {"sync": {"try_ms": offset_ms}}

    return check


def clicks_in(frames):
    return len(onsets(frames, 0.1))


@on_pulse
@pytest.mark.parametrize(("options", "keys"), [((), KEYS), (("--json",), LETTERS)])
def test_a_person_at_a_terminal_finds_a_delay_and_it_is_stored(server, options, keys, tmp_path):
    person = SimulatedPerson(130.0, 3.0, np.random.default_rng(1), lapses=0.0)
    with (
        recording(server, "desktop.monitor", tmp_path / "heard") as heard,
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
        at_a_terminal(server, *options) as (live, terminal),
    ):
        terminal.expect("Press a key to begin")
        terminal.press(b"\n")
        trials = answered(terminal, was_asked(live), person, keys)
        assert terminal.wait() == 0, terminal.shown
        assert clicks_in(heard()) >= trials.count - 1  # the last was answered before it came
        assert not np.any(felt())  # the taps are the daemon's
    found = trials.estimate()
    assert found.delay_ms == pytest.approx(130.0, abs=8.0)
    assert asked(live)[-2:] == [{"sync": {"store_ms": round(found.delay_ms, 1)}}, END]
    if options:
        shown = json.loads(terminal.shown.splitlines()[-1])
        assert shown["delay_ms"] == round(found.delay_ms, 1)
        assert (shown["stored"], shown["heard"], shown["simulated"]) == (True, "desktop", None)
        assert shown["trials"] == trials.count
    else:
        assert f"an offset of {found.delay_ms:.0f} ms" in terminal.shown
        assert "is stored for desktop" in terminal.shown


@pytest.mark.parametrize("key", [CTRL_C, CTRL_D])
def test_an_interrupted_test_ends_the_trial_and_stores_nothing(server, key):
    person = SimulatedPerson(130.0, 3.0, np.random.default_rng(1), lapses=0.0)
    with at_a_terminal(server) as (live, terminal):
        terminal.expect("Press a key to begin")
        terminal.press(b" ")
        answered(terminal, was_asked(live), person, KEYS, stop_at=2)
        terminal.expect("click 3: ")
        terminal.press(key)
        assert terminal.wait() == 130, terminal.shown
        assert asked(live)[-1] == END
    assert not any("store_ms" in request["sync"] for request in asked(live))
    assert "Traceback" not in terminal.shown


@on_pulse
def test_a_key_that_means_nothing_is_no_answer_and_the_click_comes_again(server, tmp_path):
    with (
        recording(server, "desktop.monitor", tmp_path / "heard") as heard,
        at_a_terminal(server) as (_, terminal),
    ):
        terminal.expect("Press a key to begin")
        terminal.press(b" ")
        terminal.expect("click 1: ")
        before = clicks_in(heard())
        terminal.press(b"x")
        wait_for(lambda: clicks_in(heard()) >= before + 2, "the click again")
        assert terminal.shown.endswith("click 1: ")


@on_pulse
@pytest.mark.parametrize(
    ("changed", "code", "said"),
    [
        ({"state": DaemonState.WAITING_FOR_DEVICE, "reason": "no cushion"}, 3, "no cushion"),
        ({"muted": True}, 2, "switch it on"),
        ({"tap": Endpoint("app:mpv", "mpv")}, 2, "captures app:mpv, where sync cannot play"),
        ({"levels": Levels(Level(-6.0, -9.0), Level())}, 3, "cause no vibration; unmute desktop"),
    ],
)
def test_a_daemon_that_cannot_be_tested_is_told_apart(server, changed, code, said, monkeypatch):
    monkeypatch.setattr(stand_in, "STATUS", replace(STATUS, **changed))
    with at_a_terminal(server) as (live, terminal):
        assert terminal.wait() == code, terminal.shown
    assert said in terminal.shown
    assert "click 1" not in terminal.shown
    assert asked(live)[-1:] in ([], [END])


@on_pulse
def test_what_the_daemon_refuses_is_said(server, monkeypatch):
    refusal = {"error": "sync needs a sink"}
    monkeypatch.setattr(stand_in.Settings, "control", lambda *_: refusal)
    with at_a_terminal(server) as (_, terminal):
        assert terminal.wait() == 2, terminal.shown
    assert "the daemon refuses the request: sync needs a sink" in terminal.shown


def test_a_default_tap_whose_monitor_is_not_named_is_the_default_sink(server, monkeypatch):
    several = replace(STATUS, tap=Endpoint("default", "Firefox, mpv"))
    monkeypatch.setattr(stand_in, "STATUS", several)
    with at_a_terminal(server) as (_, terminal):
        terminal.expect("Press a key to begin")


def lags_ms(heard, felt):
    """By how many ms the tap of each click in two recordings comes after the click."""
    clicks = [heard.at_s(frame) for frame in onsets(heard.frames(), 0.1)]
    taps = np.array([felt.at_s(frame) for frame in onsets(felt.frames(), 0.02)])
    return [1e3 * float(np.min((taps - click_s)[taps > click_s - 0.05])) for click_s in clicks]


@pytest.mark.calm
@pytest.mark.parametrize(
    ("server", "engine"), [("pulse", "python"), ("pipewire", "native")], indirect=["server"]
)
def test_with_a_daemon_each_tap_comes_at_its_offset_and_the_result_stays(server, engine):
    person = SimulatedPerson(130.0, 3.0, np.random.default_rng(1), lapses=0.0)
    tried_ms = []

    def feel(offset_ms):
        tried_ms.append(offset_ms)
        wait_seconds(1e-3 * offset_ms + 0.25)  # nobody answers before the tap

    with (
        running(server, engine=engine, ready=False) as daemon,
        arriving(server, "desktop.monitor") as heard,
        arriving(server, "haptic.monitor") as felt,
    ):
        daemon.wait(lambda status: status.state.value in ("running", "idle"), "the daemon")
        with Terminal("sync", env=environment(server)) as terminal:
            terminal.expect("Press a key to begin")
            terminal.press(b" ")
            trials = answered(terminal, feel, person, KEYS)
            assert terminal.wait() == 0, terminal.shown
        own_ms = np.array(lags_ms(heard, felt)[-len(tried_ms) :]) - tried_ms
        print(np.round(own_ms, 1))
        assert np.abs(own_ms - np.median(own_ms)).max() < 15.0
        found_ms = round(trials.estimate().delay_ms, 1)
        assert found_ms == pytest.approx(130.0, abs=8.0)
        status = daemon.wait(lambda s: abs(s.offset_ms - found_ms) < 6.0, "the offset")
        assert status.offset_reason == "measured by cushion sync"
