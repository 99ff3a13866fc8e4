"""Which streams are left out, and which [[application]] rule acts; without a server."""

from dataclasses import replace
from typing import Any, cast

import pytest

from audioflinger_hook.config.applications import ApplicationRule
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.applications import (
    ActingRule,
    applications_in,
    not_left_out,
    with_rule,
)
from audioflinger_hook.daemon.engine import Clocks
from audioflinger_hook.daemon.inputs.sink import SinkInput
from audioflinger_hook.daemon.native.taps import Tap
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.daemon.timing import Wake
from audioflinger_hook.sources import parse_tap
from audioflinger_hook.transform import TransformParameters
from device.address import parse_device
from device.server.left_out import LeftOut
from device.server.snapshot import ServerSnapshot, Sink, Source, Stream
from device.server.tap_volume import TapVolume
from tests.support import run_configs
from tests.support.browser_streams import PLAYING, RECORDING, felt, properties, scenes
from tests.support.graphs import desktop, link, node, play, port

INPUTS = (41, 42)
GAME = ApplicationRule(match="super*", profile="game", gain_db=-6.0)
MUSIC = ApplicationRule(match="mpv", profile="music")
SOURCE = Source(2, "desk.monitor", "", "desk", 48_000, 2, {})


def config_of(*rules, **live):
    return run_configs.config(application_rules=rules, **live)


def stream(index, application="", *, binary="", role="", corked=False, latency="", sink="desk"):
    known = {"node.latency": latency} if latency else {}
    return Stream(index, 1, sink, application, binary, role, "", None, corked, False, known)


def seen(*playing, recording=()):
    return ServerSnapshot("PipeWire", "1", "desk", "", (), (SOURCE,), playing, tuple(recording), 0)


def tapped(graph, left_out=LeftOut()):  # noqa: B008 - immutable
    tap = Tap("desk.monitor", ("FL", "FR"), "desk", None, left_out)
    return {output for output, _ in tap.mirrored(graph, "dac", INPUTS)}


@pytest.mark.parametrize(
    "properties",
    [
        *({"media.role": "Communication"}, {"media.role": "phone"}, {"media.role": "Notification"}),
        *({"media.role": "event"}, {"media.role": "Accessibility"}),
        *({"application.name": "WEBRTC VoiceEngine"}, {"application.process.binary": "Discord"}),
        *({"application.name": "Mumble"}, {"application.process.binary": "teams-for-linux"}),
    ],
)
def test_calls_and_alerts_are_not_linked_unless_the_switch_is_on(properties):
    graph = desktop()
    play(graph, 60, "film", 10, **{"media.role": "Movie"})
    play(graph, 70, "other", 10, **properties)
    assert tapped(graph) == {61, 62}
    assert tapped(graph, LeftOut(calls_and_alerts=True)) == {61, 62, 71, 72}


@pytest.mark.parametrize(("browser", "server", "scene"), scenes("pipewire"))
def test_a_browsers_call_is_left_out_while_its_film_is_felt(browser, server, scene):
    graph = desktop()
    for nodes, what in ((60, PLAYING), (90, RECORDING)):
        for at, known in enumerate(properties(browser, server, scene, what)):
            if what == PLAYING:
                play(graph, nodes + 10 * at, "browser", 10, **known)
            else:
                graph.apply([node(nodes, "microphone", "Stream/Input/Audio", **known)])
    first = [61 + 10 * at for at in felt(browser, server, scene)]
    assert tapped(graph) == {*first, *(port + 1 for port in first)}
    if 60 in graph.nodes:
        graph.apply([{"id": 90, "info": None}])
        assert 61 in tapped(graph)  # with the microphone, the call has ended


def test_a_client_that_records_only_what_a_sink_plays_makes_no_call():
    graph, one = desktop(), {"application.name": "Recorder", "media.name": "take 1"}
    play(graph, 60, "recorder", 10, **one)
    graph.apply([node(80, "tape", "Stream/Input/Audio", **{**one, "stream.capture.sink": True})])
    assert tapped(graph) == {61, 62}
    graph.apply([node(81, "microphone", "Stream/Input/Audio", **one)])
    assert tapped(graph) == set()


def test_a_stream_is_not_linked_before_its_properties_are_known():
    graph, announced = desktop(), node(60, "player", "Stream/Output/Audio")
    output = port(61, 60, "output_FL")
    output["info"]["props"]["object.serial"] = 61
    graph.announce([announced, output])
    graph.apply([link(63, 61, 11, graph)])
    assert tapped(graph) == set()
    binary = {"application.process.binary": "vesktop"}
    assert graph.apply([node(60, "player", "Stream/Output/Audio", **binary)])
    assert (tapped(graph), tapped(graph, LeftOut(calls_and_alerts=True))) == (set(), {61})
    graph.apply([announced])
    assert tapped(graph) == {61}


def test_what_the_config_leaves_out_is_not_linked_even_with_the_switch():
    graph = desktop()
    play(graph, 60, "a", 10, **{"application.name": "Game"})
    play(graph, 70, "b", 10, **{"application.process.binary": "mpv"})
    config = config_of(ApplicationRule(match="mp?", feel=False), feel_calls_and_alerts=True)
    assert tapped(graph, config.left_out) == {61, 62}


FIREFOX = {"application": "Firefox", "binary": "firefox-bin"}


@pytest.mark.parametrize(
    ("others", "live", "stream_of"),
    [
        ((ApplicationRule(match="fire*", feel=False),), {}, {}),
        ((ApplicationRule(match="firefox-bin", feel=False),), {}, {}),
        *(((), {}, {"role": "phone"}), ((), {"exclude": ("fire*",)}, {})),
        ((), {"include": ("mpv",)}, {}),
    ],
)
def test_feel_true_undoes_whatever_leaves_an_application_out(others, live, stream_of):
    playing = seen(stream(1, **FIREFOX, **stream_of))
    for own, is_felt in ((ApplicationRule(match="Firefox", feel=True), True), (None, False)):
        config = config_of(*others, *filter(None, [own]), **live)
        (shown,) = applications_in(playing, config, SOURCE, "dac")
        assert shown.is_felt == is_felt
        if config.rules is not None:
            assert bool(config.rules.select(playing, "dac")) == is_felt


def test_feel_false_leaves_out_what_a_pattern_or_a_list_includes():
    rules = ApplicationRule(match="*", feel=True), ApplicationRule(match="Firefox", feel=False)
    config = config_of(*rules, include=("firefox",))
    shown = applications_in(seen(stream(1, **FIREFOX), stream(2, "mpv")), config, SOURCE, "dac")
    assert [(one.name, one.is_felt) for one in shown] == [("Firefox", False), ("mpv", True)]


def test_the_rule_of_an_applications_own_name_acts_before_patterns_unless_it_changes_nothing():
    own = ApplicationRule(match="SuperTux", profile="music")
    program = replace(own, match="supertux2")
    none = replace(own, profile=None, feel=True)
    for rules, rule in (((GAME, own), own), ((GAME, program), program), ((GAME, none), GAME)):
        acting = ActingRule()
        acting.update(seen(stream(4, "SuperTux", binary="supertux2")), config_of(*rules), "dac")
        assert acting.rule == rule


@pytest.mark.parametrize(
    ("name", "match"), [("Film [4K", "Film [[]4K"), ("Film [4K]", "Film [4K]")]
)
def test_the_rule_of_a_name_with_a_bracket_acts_before_patterns(name, match):
    own, acting = ApplicationRule(match=match, profile="music"), ActingRule()
    acting.update(seen(stream(4, name)), config_of(replace(own, match="*"), own), "dac")
    assert acting.rule == own


EFFECTS = {"node.link-group": "effects"}
EFFECT_SINK = Sink(5, "effects", "", "", 48_000, 2, None, EFFECTS)
DESK_SINK = Sink(1, "desk", "", "desk.monitor", 48_000, 2, None, {})
TO_DESK = Stream(9, 1, "desk", "", "", "", "", None, False, False, EFFECTS)


def test_an_application_that_is_not_heard_on_the_tapped_sink_has_no_rule():
    config, television = config_of(MUSIC, GAME), stream(4, "SuperTux", sink="tv")
    through = replace(television, device_name="effects")
    cases = (television, "desk", MUSIC), (television, None, GAME), (through, "desk", GAME)
    for game, sink, rule in cases:
        acting, snapshot = ActingRule(), seen(stream(1, "mpv"), game, TO_DESK)
        snapshot = replace(snapshot, sinks=(DESK_SINK, EFFECT_SINK))
        acting.update(snapshot, config, "dac", sink)
        assert acting.rule == rule


def test_what_plays_through_a_sink_of_effects_is_felt_and_a_call_there_is_told():
    snapshot = seen(stream(3, "Zoom", sink="effects"), stream(4, "mpv", sink="effects"), TO_DESK)
    snapshot = replace(snapshot, sinks=(DESK_SINK, EFFECT_SINK))
    shown = applications_in(snapshot, config_of(), SOURCE, "dac")
    found = {one.name: (one.is_felt, one.rule) for one in shown}
    assert found == {"Zoom": (True, "call"), "mpv": (True, "")}
    assert "Zoom" in not_left_out(shown)


def test_a_call_that_is_left_out_has_no_effect_on_the_strength_of_a_film():
    tap: Any = SinkInput(parse_tap("default"), *[cast(Any, None)] * 3)
    call = replace(stream(3, "WEBRTC VoiceEngine"), volume_db=-13.0)
    snapshot = replace(seen(call, stream(4, "mpv")), sinks=(DESK_SINK,))
    tap.locate(snapshot, "dac")
    assert tap.volume_db(snapshot, LeftOut()) == 0.0
    assert tap.volume_db(snapshot, LeftOut(calls_and_alerts=True)) == 0.0  # mpv goes on
    tap._volume = TapVolume()
    assert tap.volume_db(snapshot) == -13.0  # of a monitor, which has the call


def test_a_rule_that_contradicts_the_config_does_not_act_and_does_not_refuse_the_config():
    config = replace(config_of(), tap=parse_tap("scene:demo"), device=parse_device("twin"))
    daemon = Supervisor(config, Clocks(float, float), Wake())
    daemon._acting.rule = ApplicationRule(match="mpv", profile="speech")
    narrow = replace(config, settings=Settings(parameters=TransformParameters(band_high_hz=250.0)))
    narrow = replace(narrow, settings=replace(narrow.settings, said=("band_high_hz",)))
    for one, profile, is_told in ((narrow, "paper", True), (config, "speech", False)):
        daemon.follow(one, 0.0)
        assert daemon.config.settings.profile == profile
        assert any("'mpv' of [[application]] cannot act" in w for w in daemon.warnings) == is_told
    daemon.close(0.0)


def test_the_rule_of_the_newest_application_that_is_felt_acts_and_ends_with_it():
    config, acting = config_of(MUSIC, GAME), ActingRule()
    music, game = stream(9, "mpv"), stream(4, "SuperTux")  # a game with an older stream
    paused = replace(game, corked=True)
    steps = [(seen(music, paused), MUSIC), (seen(music, game), GAME), (seen(music, paused), MUSIC)]
    for snapshot, rule in steps:
        assert acting.update(snapshot, config, "dac")
        assert acting.rule == rule
        assert not acting.update(snapshot, config, "dac")
    acting.update(seen(), config, "dac")
    assert acting.rule is None
    call = stream(3, "supercall", role="phone")
    assert not acting.update(seen(stream(1, "mpv", sink="dac"), call), config, "dac")


def test_a_rule_changes_profile_and_gain_and_nothing_else():
    config = config_of(MUSIC, GAME)
    config = replace(config, settings=config.settings.choosing(gain_db=-3.0))
    acted = with_rule(config, GAME)
    assert (acted.settings.profile, acted.settings.gain_db) == ("game", -9.0)
    assert acted.settings.parameters == Settings(profile="game").parameters
    assert acted.live == config.live
    assert with_rule(config, None) is config
    assert with_rule(config, replace(GAME, gain_db=-60.0)).settings.gain_db == -60.0


def test_the_status_says_which_rule_acts_and_why_an_application_is_left_out():
    config = config_of(GAME, ApplicationRule(match="radio", feel=False))
    names = {1: "SuperTux", 2: "Radio", 4: "Browser", 5: "Player"}
    playing = *(stream(*one) for one in names.items()), stream(3, "chime", role="event")
    microphone = replace(stream(9, "Browser"), device_index=8, device_name="microphone")
    snapshot = seen(*playing, recording=[microphone])
    shown = applications_in(snapshot, config, SOURCE, "dac", GAME)
    assert {one.name: (one.is_felt, one.rule) for one in shown} == {
        "SuperTux": (True, 'rule "super*"'),
        "Radio": (False, "left out in the config"),
        "chime": (False, "alert"),
        "Browser": (False, "call"),
        "Player": (True, ""),
    }
    assert not_left_out(shown) == ""
    both = stream(4, "Browser", latency="1024/48000"), stream(5, "Browser")
    shown = applications_in(replace(snapshot, sink_inputs=both), config, SOURCE, "dac")
    assert [(one.is_felt, one.rule) for one in shown] == [(True, "part left out: call")]
    assert not_left_out(shown) == ""


def test_the_status_says_what_a_tap_of_the_mixed_sound_cannot_leave_out():
    snapshot = seen(stream(1, "mpv"), stream(3, "chime", role="event"))
    shown = applications_in(snapshot, config_of(), SOURCE, "dac", is_mixed=True)
    assert {one.name for one in shown if one.is_felt} == {"mpv", "chime"}
    assert "mixed sound is tapped: 'chime' (alert); name" in not_left_out(shown)
