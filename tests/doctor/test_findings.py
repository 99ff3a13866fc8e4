"""Facts become findings: the rules alone, without a server."""

from dataclasses import replace
from typing import Any

import pytest

from audioflinger_hook.config.toml_text import Mistake
from audioflinger_hook.doctor.checks import find
from audioflinger_hook.doctor.facts import (
    ConfigFacts,
    DaemonFacts,
    Delay,
    Facts,
    FolderFacts,
    GraphFacts,
    PluginFacts,
    ServerFacts,
    SinkFacts,
    SystemFacts,
)
from audioflinger_hook.doctor.repair import REPAIRS
from audioflinger_hook.doctor.report import facts_text, findings_text
from audioflinger_hook.doctor.texts import TEXTS
from audioflinger_hook.service.runtime_folder import Holder
from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import Endpoint, GraphFigures, Status

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
HEALTHY = Facts(
    SystemFacts(program="1.0", priority="real-time"),
    ServerFacts(
        "PipeWire",
        "1.4.2",
        default_sink="desktop",
        sinks=(SinkFacts("desktop", 48_000, 2), SinkFacts("haptic", 48_000, 2)),
        players=("process 7",),
        graph=GraphFacts("1.4.2", 48_000, allowed_hz=(48_000,), quantum_frames=1_024),
    ),
    ConfigFacts("/config.toml", True, device="sink:haptic"),
    (FolderFacts("state", "/state", 1 << 30),),
    PluginFacts("/plugin.so"),
    DaemonFacts(STATUS, is_locked=True, service="active"),
    "desktop",
    "haptic",
)


def names(facts: Facts) -> list[str]:
    return [finding.name for finding in find(facts)]


def changed(part: str, **values: Any) -> Facts:
    """The healthy set-up with other values in one part of its facts."""
    return replace(HEALTHY, **{part: replace(getattr(HEALTHY, part), **values)})


def with_sinks(heard: SinkFacts, felt: SinkFacts, **graph: Any) -> Facts:
    assert HEALTHY.server.graph is not None
    return changed("server", sinks=(heard, felt), graph=replace(HEALTHY.server.graph, **graph))


def with_status(**values: Any) -> Facts:
    return changed("daemon", status=replace(STATUS, **values))


def test_a_healthy_set_up_has_no_finding() -> None:
    assert names(HEALTHY) == []
    assert findings_text([], []) == "Nothing is wrong."


DESKTOP, HAPTIC = HEALTHY.server.sinks
MISTAKE = Mistake("gain_db", 3, "99", "is out of range", "-60 to 24")
CASES = {
    "server-hangs": changed("server", kind="", graph=None, hangs=True),
    "no-server": changed("server", kind="", graph=None, error="nothing answers"),
    "no-pulse": changed("server", kind="", error="nothing answers"),
    "no-session-manager": with_sinks(DESKTOP, HAPTIC, has_session_manager=False),
    "pulseaudio": changed("server", kind="PulseAudio", graph=None),
    "wrong-default-sink": changed("server", default_sink="haptic"),
    "no-default-sink": changed("server", default_sink=""),
    "device-muted": with_sinks(DESKTOP, replace(HAPTIC, muted=True)),
    "device-low": with_sinks(DESKTOP, replace(HAPTIC, volume_db=None)),
    "sound-muted": with_sinks(replace(DESKTOP, muted=True), HAPTIC),
    "rate-clash": with_sinks(replace(DESKTOP, samplerate=44_100), HAPTIC),
    "no-realtime": changed("system", priority="nice", rtkit=False),
    "second-daemon": changed("server", players=("process 7", "process 8")),
    "service-failed": changed("daemon", service="failed"),
    "no-plugin": changed("plugin", built=""),
    "no-native": changed("plugin", native_problem="the program pw-cli is missing"),
    "plugin-copy": changed("plugin", installed="other version"),
    "state-folder": replace(HEALTHY, folders=(FolderFacts("state", "/x", 0, "it is a file"),)),
    "disk-full": replace(HEALTHY, folders=(FolderFacts("state", "/x", 1_000),)),
    "config": changed("config", mistakes=(MISTAKE,)),
    "daemon-version": with_status(version="0.9"),
    "daemon-waits": with_status(state=DaemonState.WAITING_FOR_DEVICE, reason="no sink"),
    "muted": with_status(muted=True),
    "python-engine": with_status(engine="python", engine_reason="the run is recorded"),
    "monitor-tap": with_status(graph=GraphFigures(1_024, 48_000, "monitor", "links refused")),
    "daemon-warns": with_status(warnings=("xruns",)),
    "not-felt": replace(HEALTHY, delay=Delay(was_played=True, reason="it stayed silent")),
    "no-daemon": changed("daemon", status=None, is_locked=False),
    "daemon-hangs": changed("daemon", status=None, holder=Holder(7, "today", "haptic")),
    "stale-lock": changed(
        "daemon", status=None, is_locked=False, holder=Holder(7, "today", "haptic")
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_each_fault_alone_gives_its_finding_alone(name: str) -> None:
    also = {"no-daemon"} if name == "stale-lock" else set()
    assert set(names(CASES[name])) == {name} | also


@pytest.mark.parametrize("name", CASES)
def test_each_finding_is_a_sentence_that_says_what_to_do(name: str) -> None:
    for finding in find(CASES[name]):
        assert finding.wrong.endswith(".")
        assert not finding.wrong.endswith("..")
        assert finding.advice.endswith(".")
        assert not finding.repair or finding.repair in REPAIRS
        assert finding.wrong in findings_text([finding], [])
    assert facts_text(CASES[name])


# Findings of other tests, and texts whose findings have another name.
ELSEWHERE = {"no-device", "no-device-chosen", "no-alsa-plugin", "daemon-silent"}
UNNAMED = {"config-unreadable", "config-mistake", "config-warning", "folder"}


def test_the_offset_and_its_origin_are_shown() -> None:
    shown = facts_text(with_status(offset_ms=194.5, offset_reason="declared by the sink"))
    assert "194.5 ms, declared by the sink" in shown


def test_every_finding_has_a_case() -> None:
    assert set(TEXTS) - ELSEWHERE - UNNAMED == set(CASES) - {"config", "state-folder"}


def test_a_daemon_or_an_engine_that_says_why_it_fails_is_a_finding() -> None:
    daemon = changed("daemon", status=None, is_locked=False, error="no answer")
    assert names(daemon) == ["daemon-silent"]
    engine = replace(
        CASES["pulseaudio"], plugin=PluginFacts("/plugin.so", alsa_problem="no plugin")
    )
    assert names(engine) == ["pulseaudio", "no-alsa-plugin"]
    unreadable = changed("config", error="no permission")
    assert [one.wrong for one in find(unreadable)] == [
        "The config file cannot be read: no permission."
    ]


def test_a_device_is_needed_while_no_daemon_plays() -> None:
    idle = changed("daemon", status=None, is_locked=False)
    assert "no-device-chosen" in names(replace(idle, config=ConfigFacts()))
    gone = ConfigFacts(device="sink:dac", device_error="there is no sink 'dac'")
    assert "no-device" in names(replace(idle, config=gone))
    assert "no-device-chosen" not in names(replace(HEALTHY, config=ConfigFacts()))


def test_rtkit_is_enough_for_real_time_priority() -> None:
    assert names(changed("system", priority="", rtkit=True)) == []
    assert names(changed("system", priority="", rtkit=None)) == ["no-realtime"]


@pytest.mark.parametrize(
    ("heard_hz", "felt_hz", "graph", "clashes"),
    [
        (44_100, 44_100, {"allowed_hz": (44_100, 48_000)}, 0),  # the graph follows
        (44_100, 48_000, {"allowed_hz": (44_100, 48_000)}, 1),  # it can follow one of them only
        (44_100, 44_100, {}, 2),
        (48_000, 48_000, {"forced_hz": 44_100}, 2),
        (44_100, 44_100, {"forced_hz": 44_100}, 0),
    ],
)
def test_a_rate_clashes_if_the_graph_cannot_follow(
    heard_hz: int, felt_hz: int, graph: dict[str, Any], clashes: int
) -> None:
    heard, felt = replace(DESKTOP, samplerate=heard_hz), replace(HAPTIC, samplerate=felt_hz)
    assert names(with_sinks(heard, felt, **graph)) == ["rate-clash"] * clashes


def test_the_rate_of_a_card_that_sleeps_is_not_judged() -> None:
    asleep = replace(DESKTOP, samplerate=44_100, rate_is_known=False)
    assert names(with_sinks(asleep, HAPTIC)) == []


def test_the_python_engine_is_no_finding_where_it_was_chosen() -> None:
    assert names(with_status(engine="python", engine_reason="engine = 'python'")) == []
