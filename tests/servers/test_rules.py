"""Calls, alerts and [[application]] rules on real servers."""

import os
import shutil
import time
from contextlib import contextmanager

import numpy as np
import pytest
import soundfile

from tests.servers.daemons import configured, cushion, felt_now, program, running, tone
from tests.servers.listening import RATE_HZ, more, playing, recording, wait_for

pytestmark = [pytest.mark.servers]

RULES = '[[application]]\nmatch = "Super*"\nprofile = "game"\ngain_db = -3\n'
RULE = '[[application]]\nmatch = "{}"\nfeel = false\n'
SWITCH = "[live]\nfeel_calls_and_alerts = true\n"
SOON_S = 0.5  # a rule acts within this time


@contextmanager
def daemon_with(server, folder, text, engine="native", **options):
    _, named = configured(folder, text)
    with (
        running(server, *named, engine=engine, **options) as daemon,
        recording(server, "haptic.monitor", folder / "felt") as felt,
    ):
        yield daemon, felt


def application(status, name):
    return next((one for one in status.applications if one.name == name), None)


@pytest.mark.parametrize(
    ("role", "why"),
    [("Communication", "call"), ("phone", "call"), ("Notification", "alert"), ("event", "alert")],
)
def test_a_call_or_alert_is_never_felt_while_music_is(pipewire, role, why, tmp_path):
    with daemon_with(pipewire, tmp_path, "") as (daemon, felt):
        with playing(pipewire, "desktop", tone(110.0, 20.0), name="Caller", role=role):
            status = daemon.wait(lambda status: application(status, "Caller"), "the call")
            more(felt, 1.0)
            assert not np.any(np.abs(felt()) > 1e-4)
            shown = application(status, "Caller")
            assert (shown.is_felt, shown.rule) == (False, why)
        with playing(pipewire, "desktop", tone(110.0, 20.0)):
            wait_for(lambda: felt_now(felt), "vibration of music")


@pytest.mark.parametrize("engine", ["python", "native"])
@pytest.mark.parametrize("name", [b"Caf\xe9", b"\xff\xfe"], ids=ascii)
def test_an_application_whose_name_is_not_utf_8_is_felt_and_ruled(pipewire, engine, name, tmp_path):
    path, wav = os.fsencode(tmp_path / "") + b"/" + name, tmp_path / "wav"
    shown = name.decode("utf-8", "replace")
    shutil.copy(str(shutil.which("pw-cat")), path)  # PipeWire names a stream after its program
    soundfile.write(wav, tone(110.0, 60.0), RATE_HZ, format="WAV")
    play = (path, "-p", "--target", "desktop", wav)
    with (
        program(pipewire.environment, *play),
        daemon_with(pipewire, tmp_path, "", engine=engine) as (daemon, felt),
    ):
        daemon.wait(lambda status: application(status, shown), "the application")
        wait_for(lambda: felt_now(felt), "its vibration")
        assert cushion(pipewire, "devices").code == 0
        with playing(pipewire, "desktop", tone(220.0, 20.0), name="Plain"):
            daemon.wait(lambda status: application(status, "Plain"), "another application")
        daemon.reload(tmp_path / "config.toml", RULE.format(shown))
        ruled = "left out in the config"
        daemon.wait(lambda status: application(status, shown).rule == ruled, "the rule")


@pytest.mark.parametrize("recorder", ["Chromium", "Firefox"])
def test_a_browsers_call_is_left_out_while_its_film_is_felt(server, recorder, tmp_path):
    """With the names, process and latencies of tests/device/server/browser_streams.json.

    On PulseAudio, the film of Chromium cannot be told from its call.
    """
    process = {"application.process.id": "4711", "application.process.binary": recorder.lower()}
    titles = {"Chromium": ("Playback", "Playback", "RecordStream"), "Firefox": ("A", "B", "B")}
    film, call, voice = ({**process, "media.name": title} for title in titles[recorder])
    voice["application.name"] = "Chromium input" if recorder == "Chromium" else recorder
    is_pipewire = server.kind == "pipewire"
    text = "" if is_pipewire else '[applications]\ninclude = ["*"]\n'
    engine = "native" if is_pipewire else "python"
    server.add_microphone("microphone")
    plain = {"name": recorder, "role": ""}
    with (
        recording(server, "microphone", tmp_path / "voice", properties=voice),
        daemon_with(server, tmp_path, text, engine=engine, ready=is_pipewire) as (daemon, felt),
        playing(server, "desktop", tone(110.0, 60.0), latency_ms=15, properties=call, **plain),
    ):
        status = daemon.wait(lambda status: application(status, recorder), "the call")
        shown = application(status, recorder)
        assert not shown.is_felt
        assert shown.rule.startswith("call")
        more(felt, 1.0)
        assert not np.any(np.abs(felt()) > 1e-4)
        with playing(server, "desktop", tone(110.0, 60.0), properties=film, **plain):
            if not is_pipewire and recorder == "Chromium":
                more(felt, 1.0)
                assert not np.any(np.abs(felt()) > 1e-4)
                return
            wait_for(lambda: felt_now(felt), "vibration of the film")
            status = daemon.wait(lambda status: application(status, recorder).is_felt, "the film")
            assert application(status, recorder).rule.startswith("part left out: call")
        wait_for(lambda: not felt_now(felt), "the end of the vibration")


def test_a_call_is_felt_with_the_switch(pipewire, tmp_path):
    with (
        daemon_with(pipewire, tmp_path, SWITCH) as (_, felt),
        playing(pipewire, "desktop", tone(110.0, 20.0), role="phone"),
    ):
        wait_for(lambda: felt_now(felt), "vibration of the call")


def test_a_game_over_music_brings_its_profile_within_half_a_second_and_back(pipewire, tmp_path):
    with (
        daemon_with(pipewire, tmp_path, RULES) as (daemon, felt),
        playing(pipewire, "desktop", tone(110.0, 60.0), name="Music"),
    ):
        wait_for(lambda: felt_now(felt), "vibration")
        process = daemon.engine_process()
        assert daemon.status().profile == "cinema"
        more(felt, 3.0)  # a player is opened a while before the game
        began_s = time.monotonic()
        with playing(pipewire, "desktop", tone(80.0, 30.0), name="SuperTux"):
            status = daemon.wait(lambda status: status.profile == "game", "the game's profile")
            took_s = time.monotonic() - began_s
            assert status.rule == "Super*"
            assert "Super*" in cushion(pipewire, "status").stdout
            more(felt, 1.0)
        began_s = time.monotonic()
        status = daemon.wait(lambda status: status.profile == "cinema", "the config's profile")
        back_s = time.monotonic() - began_s
        assert (status.rule, status.engine_pid) == ("", process)  # nothing was started anew
        assert felt_now(felt)
    assert max(took_s, back_s) < SOON_S + 0.5, (took_s, back_s)  # pacat starts meanwhile


def test_pulseaudio_says_which_alert_it_cannot_leave_out(pulse, tmp_path):
    with (
        daemon_with(pulse, tmp_path, "", engine="python") as (daemon, _),
        playing(pulse, "desktop", tone(110.0, 20.0), name="Chime", role="event"),
    ):
        status = daemon.wait(lambda status: application(status, "Chime"), "the alert")
        assert application(status, "Chime").rule == "alert"
        daemon.wait(lambda status: "'Chime' (alert)" in " ".join(status.warnings), "the warning")
