"""Facts become findings: the rules alone, without a server."""

import math
import re
from dataclasses import replace
from typing import Any

import pytest

from audioflinger_hook.config.settings import LiveSettings
from audioflinger_hook.config.toml_text import Mistake
from audioflinger_hook.daemon.outputs.sink import muted
from audioflinger_hook.doctor.checks import TEXTS, find
from audioflinger_hook.doctor.facts import Delay, Facts, Folder
from audioflinger_hook.doctor.reading import _with_config
from audioflinger_hook.doctor.repair import REPAIRS
from audioflinger_hook.doctor.report import facts_text, findings_text
from audioflinger_hook.service.runtime_folder import Holder
from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import Endpoint, GraphFigures, Status
from device.server.graph import Graph
from device.server.snapshot import Sink
from tests.support.graphs import Item, node
from tests.support.snapshots import sink, snapshot

STATUS = Status(
    version="1.0",
    pid=7,
    state=DaemonState.RUNNING,
    reason="",
    since_s=1.0,
    tap=Endpoint("default", "desktop"),
    device=Endpoint("sink:haptic", "haptic"),
    engine="native",
)
MANAGER: Item = {
    "id": 5,
    "type": "PipeWire:Interface:Client",
    "info": {"props": {"application.name": "WirePlumber", "object.serial": 5}},
}
# Findings of other tests
ELSEWHERE = {"no-device", "no-device-chosen", "no-alsa-plugin", "daemon-silent"}


def graph(*items: Item, **clock: object) -> Graph:
    settings = {"rate": 48_000, "allowed-rates": "[ 48000 ]", "quantum": 1_024}
    settings |= {key.replace("_", "-"): value for key, value in clock.items()}
    listed = [{"key": f"clock.{key}", "value": value} for key, value in settings.items()]
    made = Graph()
    core = {"id": 0, "type": "PipeWire:Interface:Core", "info": {"version": "1.4.2"}}
    props = {"metadata.name": "settings"}
    stored = {"id": 1, "type": "PipeWire:Interface:Metadata", "props": props, "metadata": listed}
    made.apply([core, stored, *(items or [MANAGER])])
    return made


DESKTOP, HAPTIC = sink(1, "desktop"), sink(2, "haptic")
SERVER = snapshot("PipeWire", version="1.4.2", default_sink="desktop", sinks=(DESKTOP, HAPTIC))
HEALTHY = Facts(
    program="1.0",
    is_realtime=True,
    server=SERVER,
    players=("process 7",),
    graph=graph(),
    live=LiveSettings(device="sink:haptic"),
    folders=(Folder("state", "/state", 1 << 30),),
    is_built=True,
    status=STATUS,
    is_locked=True,
    service="active",
)
IDLE = replace(HEALTHY, status=None, is_locked=False)


def names(facts: Facts) -> list[str]:
    return [finding.name for finding in find(facts)]


def changed(**values: Any) -> Facts:
    return replace(HEALTHY, **values)


def with_server(**values: Any) -> Facts:
    return changed(server=replace(SERVER, **values))


def with_sinks(heard: Sink, felt: Sink, **clock: object) -> Facts:
    return replace(with_server(sinks=(heard, felt)), graph=graph(**clock))


def with_status(**values: Any) -> Facts:
    return changed(status=replace(STATUS, **values))


def test_a_healthy_set_up_has_no_finding_and_every_finding_has_a_case() -> None:
    assert (names(HEALTHY), findings_text([], [])) == ([], "Nothing is wrong.")
    assert {name.split()[0] for name in TEXTS} - ELSEWHERE == set(CASES)
    assert set(REPAIRS) <= set(TEXTS)


MISTAKE = Mistake("gain_db", 3, "99", "is out of range", "-60 to 24")
CASES = {
    "server-hangs": changed(server=None, graph=None, hangs=True),
    "no-server": changed(server=None, graph=None, server_error="nothing answers"),
    "no-pulse": changed(server=None, server_error="nothing answers"),
    "no-session-manager": changed(graph=graph(node(10, "desktop", "Audio/Sink"))),
    "pulseaudio": replace(with_server(kind="PulseAudio"), graph=None),
    "wrong-default-sink": with_server(default_sink="haptic"),
    "no-tap": replace(IDLE, live=LiveSettings(tap=("sink:haptic",), device="sink:haptic")),
    "no-default-sink": with_server(default_sink=""),
    "device-muted": with_sinks(DESKTOP, replace(HAPTIC, mute=True)),
    "device-low": with_sinks(DESKTOP, replace(HAPTIC, volume_db=-math.inf)),
    "sound-muted": with_sinks(replace(DESKTOP, volume_db=-math.inf), HAPTIC),
    "rate-clash": with_sinks(replace(DESKTOP, samplerate=44_100), HAPTIC),
    "no-realtime": changed(is_realtime=False, rtkit=False),
    "second-daemon": changed(players=("process 7", "process 8")),
    "service-failed": changed(service="failed"),
    "no-plugin": changed(is_built=False),
    "no-native": changed(native_problem="the program pw-cli is missing"),
    "plugin-copy": changed(installed="of another version"),
    "folder": changed(folders=(Folder("state", "/x", 0, "it is a file"),)),
    "disk-full": changed(folders=(Folder("state", "/x", 1_000),)),
    "config": changed(mistakes=(MISTAKE,)),
    "daemon-version": with_status(version="0.9"),
    "daemon-waits": with_status(state=DaemonState.WAITING_FOR_DEVICE, reason="no sink"),
    "muted": with_status(muted=True),
    "python-engine": with_status(engine="python", engine_reason="the run is recorded"),
    "monitor-tap": with_status(graph=GraphFigures(1_024, 48_000, "monitor", "links refused")),
    "daemon-warns": with_status(warnings=("xruns",)),
    "not-felt": changed(delay=Delay(was_played=True, reason="it stayed silent")),
    "no-daemon": IDLE,
    "daemon-hangs": changed(status=None, holder=Holder(7, "today", "haptic")),
    "stale-lock": replace(IDLE, holder=Holder(7, "today", "haptic")),
}


@pytest.mark.parametrize("name", CASES)
def test_each_fault_gives_its_finding_alone_in_sentences_that_say_what_to_do(name: str) -> None:
    also = {"no-daemon"} if name in ("stale-lock", "no-tap") else set()
    assert set(names(CASES[name])) == {name} | also
    for finding in find(CASES[name]):
        assert re.search(r"[^.]\.\Z", finding.wrong)
        assert finding.advice.endswith(".")
        assert finding.wrong in findings_text([finding], [])
    assert facts_text(CASES[name])


def test_the_offset_is_shown_and_pulseaudio_leads_to_the_drop_in_mode_that_finds_it() -> None:
    shown = facts_text(with_status(offset_ms=194.5, offset_reason="declared by the sink"))
    assert "194.5 ms, declared by the sink" in shown
    (found,) = find(CASES["pulseaudio"])
    assert found.command == "cushion run --drop-in"


def test_a_daemon_an_engine_or_a_config_that_says_what_is_wrong_is_a_finding() -> None:
    assert names(replace(IDLE, daemon_error="no answer")) == ["daemon-silent"]
    open_folder = Folder("runtime", "/run/x", 1 << 30, "open to others")
    assert names(replace(IDLE, daemon_error="open to others", folders=(open_folder,))) == ["folder"]
    engine = replace(CASES["pulseaudio"], alsa_problem="no plugin")
    assert names(engine) == ["pulseaudio", "no-alsa-plugin"]
    (unreadable,) = find(changed(config_error="no permission"))
    assert unreadable.wrong == "The config file cannot be read: no permission."
    assert names(changed(config_warnings=("it is slow",))) == ["config"]


@pytest.mark.parametrize(
    ("warning", "wrong", "advice"),
    [
        ("mpv is slow; name it", "mpv is slow", "Name it."),
        ("a; b; put `c` there", "a; b", "Put `c` there."),
        ("7 is wrong; allowed: 8", "7 is wrong; allowed: 8", "Read the messages before this"),
    ],
)
def test_the_last_part_of_a_daemons_warning_is_the_advice(warning, wrong, advice) -> None:
    (found,) = find(with_status(warnings=(warning,)))
    assert found.wrong == f"The daemon warns: {wrong}."
    assert found.advice.startswith(advice)
    assert bool(found.command) == advice.startswith("Read")


def test_a_warning_of_a_cause_that_is_a_finding_is_not_repeated() -> None:
    both = replace(SERVER, sinks=(replace(DESKTOP, mute=True), replace(HAPTIC, mute=True)))
    heard = "desktop is muted or at 0 %, so its sound causes no vibration; unmute it"
    tapped = "the sink's monitor is tapped, one cycle later: links refused"
    warnings = (muted("haptic"), heard, tapped)
    status = replace(STATUS, warnings=warnings, graph=GraphFigures(1_024, 48_000, "monitor", "?"))
    assert names(changed(server=both, status=status)) == [
        "device-muted",
        "sound-muted",
        "monitor-tap",
    ]
    assert names(with_status(warnings=warnings)) == ["daemon-warns"] * 3


@pytest.mark.parametrize(
    ("lines", "found"),
    [
        ('tap = "sink:desktop"\ndevice = "haptic"', []),
        ('tap = "sink:desktp"\ndevice = "haptic"', ["no-tap"]),
        ('tap = "file:/no/film.wav"\ndevice = "haptic"', ["no-tap"]),
        ('device = "hw:nocard"', ["no-device"]),
    ],
)
def test_a_tap_or_card_of_the_config_that_is_missing_is_named(lines, found, tmp_path, monkeypatch):
    (tmp_path / "cushion").mkdir()
    (tmp_path / "cushion" / "config.toml").write_text(lines)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert names(_with_config(IDLE)) == [*found, "no-daemon"]


def test_a_device_is_needed_while_no_daemon_plays_and_beside_the_server_no_engine_of_it() -> None:
    assert names(replace(IDLE, live=LiveSettings())) == ["no-device-chosen", "no-daemon"]
    gone = replace(IDLE, device_error="there is no sink 'dac'")
    assert (names(gone), names(changed(live=LiveSettings()))) == (["no-device", "no-daemon"], [])
    assert names(changed(is_on_server=False, native_problem="pw-cli is missing")) == []


@pytest.mark.parametrize(("rtkit", "found"), [(True, []), (None, ["no-realtime"])])
def test_rtkit_is_enough_for_real_time_priority(rtkit: bool | None, found: list[str]) -> None:
    assert names(changed(is_realtime=False, rtkit=rtkit)) == found


@pytest.mark.parametrize(
    ("heard_hz", "felt_hz", "clock", "clashes"),
    [
        (44_100, 44_100, {"allowed_rates": "[ 44100, 48000 ]"}, 0),  # the graph follows
        (44_100, 48_000, {"allowed_rates": "[ 44100, 48000 ]"}, 1),  # it can follow only one
        (44_100, 44_100, {}, 2),
        (48_000, 48_000, {"force_rate": 44_100}, 2),
        (44_100, 44_100, {"force_rate": 44_100}, 0),
    ],
)
def test_a_rate_clashes_if_the_graph_cannot_follow(heard_hz, felt_hz, clock, clashes):
    heard, felt = replace(DESKTOP, samplerate=heard_hz), replace(HAPTIC, samplerate=felt_hz)
    assert names(with_sinks(heard, felt, **clock)) == ["rate-clash"] * clashes


def test_neither_a_sleeping_card_s_rate_nor_a_python_engine_that_was_chosen_is_judged() -> None:
    facts = with_sinks(replace(DESKTOP, samplerate=44_100), HAPTIC)
    card = node(10, "desktop", "Audio/Sink")
    assert names(replace(facts, graph=graph(MANAGER, card))) == ["rate-clash"]
    card["info"]["state"] = "suspended"
    assert names(replace(facts, graph=graph(MANAGER, card))) == []
    assert names(with_status(engine="python", engine_reason="engine = 'python'")) == []
