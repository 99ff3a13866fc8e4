import re
from functools import partial

import pytest

from audioflinger_hook.service.sync_trials import SimulatedPerson
from tests.support.commands import call, document, refused
from tests.support.terminal import Terminal


@pytest.mark.parametrize("delay_ms", [30, 72.5, 180, 300])
def test_the_delay_of_a_simulated_person_is_found_in_a_minute(delay_ms):
    found = document("sync", "--simulate", f"{delay_ms}:5", "--seed", 1)
    assert found["delay_ms"] == pytest.approx(delay_ms, abs=8.0)
    assert found["low_ms"] <= found["delay_ms"] <= found["high_ms"]
    assert 8 <= found["trials"] <= 45
    assert found["duration_s"] <= 60.0
    assert found["simulated"] == {"delay_ms": delay_ms, "scatter_ms": 5.0}
    assert (found["stored"], found["heard"], found["clipped"]) == (False, None, False)


def test_the_scatter_is_15_ms_if_not_given_and_the_seed_repeats_a_person():
    found = document("sync", "--simulate", 180, "--seed", 1)
    assert found["simulated"]["scatter_ms"] == 15.0
    assert document("sync", "--simulate", "180:15", "--seed", 1) == found
    assert document("sync", "--simulate", 180, "--seed", 2) != found


def test_the_result_is_a_sentence_with_the_interval_and_the_number_of_answers():
    done = call("sync", "--simulate", "180:5", "--seed", 1)
    assert (done.code, done.stderr) == (0, "")
    assert done.stdout.startswith("The vibration needs an offset of 180 ms (95 %: 17")
    assert "answers)" in done.stdout
    assert "stored" not in done.stdout


@pytest.mark.parametrize("option", [["--simulate", "-60"], ["--simulate=-60:15"]])
def test_a_sound_before_its_vibration_gives_0_and_says_so(option):
    done = call("sync", *option, "--seed", 1)
    assert "an offset of 0 ms" in done.stdout
    assert "below 0, so the offset is 0, and the vibration may come after" in done.stdout
    found = document("sync", *option, "--seed", 1)
    assert (found["delay_ms"], found["clipped"]) == (0.0, True)


@pytest.mark.parametrize(
    "value", ["soon", "", "1:2:3", "100:", "480.1", "-101", "nan", "9:0", "9:1e9"]
)
def test_a_simulated_person_of_no_sense_is_refused_with_what_is_allowed(value):
    said = refused(call("sync", f"--simulate={value}"))
    assert repr(value) in said
    assert "allowed: MS -100 to 480, SCATTER_MS 1 to 100" in said


def test_a_negative_seed_and_answers_that_leave_the_delay_open_are_refused(monkeypatch):
    assert "seed=-1" in refused(call("sync", "--simulate", 100, "--seed", "-1"))
    guesses = partial(SimulatedPerson, lapses=1.0)
    monkeypatch.setattr("audioflinger_hook.service.sync_trials.SimulatedPerson", guesses)
    said = refused(call("sync", "--simulate", 150, "--seed", 1, "--json"))
    assert "answers leave the delay between" in said
    assert "so nothing was stored; run `cushion sync` again" in said


def test_a_delay_above_480_ms_is_refused_with_its_reason(monkeypatch):
    monkeypatch.setattr("audioflinger_hook.cli.sync.FOUND_MS", 600.0)
    for delay_ms in (495, 600):
        said = refused(call("sync", "--simulate", f"{delay_ms}:5", "--seed", 1))
        assert re.search(r"the delay is 4\d\d ms or more, .*; set offset_ms", said)


def test_without_a_terminal_it_asks_nothing():
    for options in ((), ("--json",)):
        assert "not a terminal" in refused(call("sync", *options))


def test_without_a_daemon_it_says_how_to_start_one(tmp_path):
    with Terminal("sync", env={"XDG_RUNTIME_DIR": str(tmp_path)}) as terminal:
        assert terminal.wait() == 3, terminal.shown
    assert "cushion: error: no daemon is running; start one with `cushion run`\n" in terminal.shown
