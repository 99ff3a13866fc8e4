import json
from dataclasses import replace

import numpy as np
import pytest

from audioflinger_hook.cli import doctor
from audioflinger_hook.config.settings import LiveSettings
from audioflinger_hook.config.toml_text import Mistake
from audioflinger_hook.doctor import measurement, reading
from audioflinger_hook.doctor.checks import find
from audioflinger_hook.doctor.facts import Delay, Facts, Folder
from audioflinger_hook.doctor.measurement import RATE_HZ, Recording, delay_between
from audioflinger_hook.doctor.report import HIDDEN, anonymous, facts_text, full_report
from audioflinger_hook.service.status import Application, Endpoint
from device.server.graph import Graph
from tests.doctor.test_findings import CASES, HEALTHY, SERVER, STATUS
from tests.support.commands import call
from tests.support.data import table, text
from tests.support.graphs import link, node, port
from tests.support.snapshots import stream

PERSON = ("anna", "/home/anna", "annas-box")


@pytest.mark.parametrize(
    "line",
    table("report-lines.toml")["with_secrets"],
)
def test_paths_and_quoted_names_are_hidden(line: str) -> None:
    shown = anonymous(line, {"haptic"}, PERSON)
    assert "secret" not in shown
    assert HIDDEN in shown


@pytest.mark.parametrize(
    "line",
    table("report-lines.toml")["without"],
)
def test_what_a_helper_needs_stays(line: str) -> None:
    assert anonymous(line, {"haptic"}, PERSON) == line.replace('"$USER - rtprio 20"', HIDDEN)


def test_the_person_the_machine_and_values_of_a_config_are_hidden_and_its_keys_stay() -> None:
    mistakes = (
        Mistake("effects_file", 1, '"/a/it\'s, my; secret.xml"', "cannot be used", "a file"),
        Mistake('tap = "app:secret', 2, "", "is not TOML (unclosed)", "key = value"),
        Mistake("gain_db", 3, "99", "is out of range", "-60 to 24"),
    )
    live, status = LiveSettings(tap=("app:secret",)), replace(STATUS, tap=Endpoint("app:secret"))
    facts = replace(HEALTHY, mistakes=mistakes, live=live, status=status)
    text = full_report(facts, find(facts), [], PERSON)
    assert "secret" not in text
    assert "effects_file" in text
    assert "gain_db = 99 is out of range" in text
    assert anonymous("run as anna on annas-box", set(), PERSON) == f"run as {HIDDEN} on {HIDDEN}"


def test_the_report_shows_no_name_of_an_application_a_stream_or_a_rule() -> None:
    known = {"binary": "secret", "application": "secret", "media": "secret"}
    server = replace(SERVER, sink_inputs=(stream(9, 1, "desktop", **known),))
    status = replace(
        STATUS,
        reason="waits for secret",
        rule="secret",
        tap=Endpoint("default", "secret"),
        applications=(Application("hush", plays=True, is_felt=True),),
        warnings=("hush, secret, 'Sissy's \"secret\"' and Sissy's \"secret\" are felt",),
    )
    names = {"application": 'Sissy\'s "secret"', "media": "PipeWire"}
    server = replace(server, sink_inputs=(*server.sink_inputs, stream(8, 1, "desktop", **names)))
    chain = Graph()
    chain.apply([node(60, "haptic-cushion-7-1.tap"), port(61, 60, "input_AUX0")])
    chain.apply([node(70, "secret"), port(71, 70, "output_FL")])
    chain.apply([link(80, 71, 61, chain)])
    facts = replace(HEALTHY, server=server, graph=chain, status=status, pipewire="1.4.2")
    facts = replace(
        facts, errors=("cushion: warning: secret is loud", "cushion: error: no /a/secret")
    )
    text = full_report(facts, find(facts), [], PERSON)
    assert "secret" not in text
    assert "Sissy" not in text
    assert "hush" not in text
    assert f"last error:         cushion: warning: {HIDDEN} is loud" in text
    assert "PipeWire:           1.4.2" in text  # the name of a stream, and a word of the doctor
    assert "stream 70 -> haptic-cushion-7-1.tap (active) x 1" in text
    assert "running, for 1.0 s" in text


def test_on_pulseaudio_a_measured_delay_is_not_a_cycle_longer() -> None:
    delay = Delay(12.3, bursts=4, was_played=True)
    assert "median of 4 bursts; the true" in facts_text(replace(HEALTHY, delay=delay))
    assert "12.3 ms (median of 4 bursts)" in facts_text(replace(HEALTHY, delay=delay, graph=None))


BLOCK = 512


def recorded(delay_s: float, begins_s: float, level: float, late_s: float) -> Recording:
    """A recording that begins at begins_s; each block arrives up to late_s late."""
    time_s = begins_s + np.arange(round(measurement.LASTS_S * RATE_HZ)) / RATE_HZ
    sound = np.zeros(time_s.size, np.float32)
    for start_s in measurement.BURSTS_AT_S:
        since_s = time_s - start_s - delay_s
        is_on = (since_s >= 0.0) & (since_s < measurement.BURST_S)
        sound[is_on] = level * np.cos(2.0 * np.pi * 100.0 * since_s[is_on])
    random, recording = np.random.default_rng(1), Recording()
    for first in range(0, time_s.size - BLOCK, BLOCK):
        arrives_s = begins_s + (first + BLOCK) / RATE_HZ + random.uniform(0.0, late_s)
        recording.add(sound[first : first + BLOCK, None], arrives_s)
    return recording


@pytest.mark.parametrize("delay_s", [0.0, 0.012, 0.09, 0.25])
def test_a_delay_is_found_to_2_ms_although_blocks_arrive_late(delay_s: float) -> None:
    found = delay_between(recorded(0.0, 0.1, 0.3, 0.002), recorded(delay_s, 0.37, 0.05, 0.012))
    assert found.bursts >= 3
    assert found.delay_ms == pytest.approx(1e3 * delay_s, abs=2.0)


def test_silence_is_said_and_not_measured_and_nothing_is_played_without_a_daemon() -> None:
    silent, loud = recorded(0.0, 0.0, 0.0, 0.0), recorded(0.0, 0.0, 0.3, 0.0)
    assert "sound stayed silent" in delay_between(silent, loud).reason
    assert "vibration stayed silent" in delay_between(loud, silent).reason
    assert delay_between(Recording(), Recording()).delay_ms is None
    reason = "not measured: no daemon plays; start `cushion run`"
    assert measurement.measure(Facts()) == Delay(reason=reason)


JOURNAL = text("journal.txt")


@pytest.mark.parametrize(("state", "count"), [("failed", 5), ("", 0)])
def test_the_last_errors_of_a_known_service_are_read(tmp_path, monkeypatch, state, count):
    (tmp_path / "journal").write_text(JOURNAL)
    for name, does in (("systemctl", f"echo {state}"), ("journalctl", f"cat {tmp_path}/journal")):
        (tmp_path / name).write_text(f"#!/bin/sh\n{does}\n")
        (tmp_path / name).chmod(0o700)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    home = {"HOME": str(tmp_path), "XDG_RUNTIME_DIR": str(tmp_path)}
    found = reading._with_daemon(Facts(), float, home)
    assert (found.service, len(found.errors)) == (state, count)
    if count:
        assert found.errors[0] == "2026-11-29T09:00:01+0000 cushion: warning: a; b"
        assert [one[25:] for one in found.errors[-2:]] == [
            "cushion.service: Failed with result 'exit-code'.", "cushion: error: f"
        ]  # fmt: skip


@pytest.mark.parametrize("shape", [[], ["--json"]])
def test_a_report_that_cannot_be_written_hides_neither_finding_nor_repair(
    tmp_path, monkeypatch, shape
):
    muted = replace(CASES["device-muted"], errors=("cushion: error: x",))
    monkeypatch.setattr(doctor, "read_facts", lambda *_: muted)
    monkeypatch.setattr(doctor, "repair", lambda *_: "it stays muted.")
    done = call("doctor", "--fix", "--report", tmp_path / "no" / "report.txt", *shape)
    assert done.code == 2
    assert "report.txt" in done.stderr
    assert "is muted, at volume 100 %" in done.stdout
    assert "it stays muted." in done.stdout
    if shape:
        facts = json.loads(done.stdout)["facts"]
        assert {"label": "last error", "text": "cushion: error: x"} in facts


def runtime_folder(home, **variables: str) -> Folder:
    folders = reading._machine({"HOME": str(home), **variables}).folders
    return next(one for one in folders if one.what == "runtime")


def test_a_folder_that_the_daemon_makes_may_be_missing_but_not_the_system_s(tmp_path, monkeypatch):
    found = runtime_folder(tmp_path, XDG_RUNTIME_DIR=str(tmp_path))
    assert (found.path, found.problem) == (str(tmp_path / "cushion"), "")
    assert found.free_bytes > 0
    found = runtime_folder(tmp_path, XDG_RUNTIME_DIR=str(tmp_path / "run"))
    assert (found.path, "XDG_RUNTIME_DIR" in found.problem) == (str(tmp_path / "run"), True)
    # Without a runtime folder of the system a temporary one is used.
    monkeypatch.setattr("os.geteuid", lambda: 4_000_000)  # this user has no /run/user/UID
    found = runtime_folder(tmp_path, TMPDIR=str(tmp_path))
    assert (found.path, found.problem) == (str(tmp_path / "cushion-4000000"), "")
