import os
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.errors import LostError, UsageError
from device.server import PulseConnection
from device.server.app_rules import AppRules, app_name
from device.server.guard import Hold, StreamGuard, StreamPlacement
from device.server.left_out import CALL, MIXED, LeftOut
from device.server.snapshot import Event, ServerSnapshot, Stream
from device.stream.pcms import APPLICATION_ID, ROLE, TAG
from device.stream.streams import PlaybackStream
from tests.support.browser_streams import FELT, PLAYING, RECORDING, SCENES, felt, made, scenes
from tests.support.snapshots import monitor, sink, snapshot, source, stream
from tools.browser_streams import SCENES as RECORDED_SCENES

OUR_SINK, OTHER_SINK, OUR_STREAM, OTHER_STREAM = 1, 2, 10, 11
MICROPHONE, MONITOR = 3, 4


def ours(on: int | None, index: int = OUR_STREAM, tag: str = "ours") -> Stream:
    return stream(index, on, properties={TAG: tag})


def seen(on: int | None, events: int = 0, **changes: Any) -> ServerSnapshot:
    speakers = sink(OTHER_SINK, "speakers")
    known: dict[str, Any] = {
        "sinks": (sink(OUR_SINK, "dac"), speakers),
        "sources": (source(MICROPHONE, "microphone"), monitor(speakers, MONITOR)),
        "sink_inputs": (ours(OTHER_SINK, OTHER_STREAM, "other"), ours(on)),
    }
    return snapshot(events=events, **(known | changes))


def event(number: int, kind: str, facility: str, index: int) -> Event:
    return Event(facility, kind, index, number)


def test_what_plays_to_a_sink_is_neither_paused_nor_on_another_sink() -> None:
    playing, paused = stream(5, 1, "dac"), stream(6, 1, "dac", corked=True)
    found = snapshot(sinks=(sink(1, "dac"),), sink_inputs=(playing, paused, stream(7, 2, "tv")))
    assert (found.playing_to("dac"), found.playing_to(None)) == ([playing], [])


PLACED = StreamPlacement("ours", "dac").after_snapshot(seen(OUR_SINK))


def test_on_its_device_it_may_sound_and_elsewhere_it_may_not():
    assert PLACED.hold is Hold.FREE
    assert PLACED.after_snapshot(seen(OTHER_SINK)).hold is Hold.ELSEWHERE
    assert PLACED.after_snapshot(seen(None)).hold is Hold.NO_STREAM
    assert PLACED.after_snapshot(seen(OUR_SINK, sink_inputs=())).hold is Hold.NO_STREAM
    assert PLACED.after_snapshot(seen(OUR_SINK, sinks=())).hold is Hold.NO_DEVICE
    assert PLACED.after_loss().hold is Hold.LOST
    assert StreamPlacement("ours", "dac").hold is Hold.LOST


@pytest.mark.parametrize(
    ("kind", "facility", "index", "hold"),
    [
        ("change", "sink_input", OUR_STREAM, Hold.UNSETTLED),
        ("remove", "sink_input", OUR_STREAM, Hold.NO_STREAM),
        ("remove", "sink", OUR_SINK, Hold.NO_DEVICE),
    ],
)
def test_an_event_silences_until_a_look_that_is_not_older(kind, facility, index, hold):
    moved = PLACED.after_event(event(7, kind, facility, index))
    assert moved.hold is hold
    assert not moved.after_snapshot(seen(OUR_SINK, events=6)).hold.audible
    assert moved.after_snapshot(seen(OUR_SINK, events=7)).hold is Hold.FREE


def test_events_of_others_silence_nothing():
    others = event(7, "change", "sink_input", OTHER_STREAM), event(8, "remove", "sink", OTHER_SINK)
    ours = event(9, "change", "sink", OUR_SINK), event(9, "remove", "source", OUR_SINK)
    for one in (*others, *ours):
        assert PLACED.after_event(one).hold is Hold.FREE


def test_a_microphone_is_never_the_device_of_a_tap_but_its_monitor_is():
    taps = (ours(MICROPHONE), ours(MONITOR, OTHER_STREAM, "tap"))
    microphone = StreamPlacement("ours", "microphone", plays=False)
    of_monitor = StreamPlacement("tap", "speakers.monitor", plays=False)
    placed = (microphone, of_monitor, replace(microphone, any_source=True))
    holds = [one.after_snapshot(seen(OUR_SINK, source_outputs=taps)).hold for one in placed]
    assert holds == [Hold.NO_DEVICE, Hold.FREE, Hold.FREE]


@given(st.lists(st.sampled_from(["here", "there", "event", "lost"]), max_size=12))
def test_the_stream_is_audible_exactly_while_the_last_word_was_that_it_is_here(story):
    listeners: list[Any] = []
    connection = SimpleNamespace(add=listeners.append, remove=listeners.remove)
    playback = PlaybackStream.__new__(PlaybackStream)
    playback.audible = True
    playback.tag = "ours"
    guard = StreamGuard(cast(PulseConnection, connection), playback, "dac")
    assert not playback.audible
    number, known = 0, False
    for word in story:
        if word == "event":
            number += 1
            guard.on_event(event(number, "change", "sink_input", OUR_STREAM))
        elif word == "lost":
            guard.on_lost(LostError("gone"))
        else:
            guard.on_snapshot(seen(OUR_SINK if word == "here" else OTHER_SINK, events=number))
        known = word == "here"
        assert playback.audible == known
    guard.release()
    guard.on_snapshot(seen(OUR_SINK, events=number))
    assert not playback.audible
    assert not listeners


NAMES = st.text(
    st.characters(codec="utf-8", exclude_characters="*?[]:", exclude_categories=("Cc", "Cs")),
    min_size=1,
    max_size=12,
).filter(lambda name: name == name.strip())


ONE_RULE = st.sampled_from(["firefox", "m*", "role:game", "binary:doom", "*", "x"])
RULES = st.lists(ONE_RULE, max_size=3)


def playing(index: int, *names: str, place: str | None = "desktop", **properties: str) -> Stream:
    """names: application, binary and role."""
    known: dict[str, Any] = dict(zip(("application", "binary", "role"), names, strict=False))
    where = {"desktop": 1, "haptic": 2, None: None}[place]
    tags = {name.replace("_", "."): value for name, value in properties.items()}
    known |= {"media": "a song", "process_id": 999_999, "properties": tags}
    return stream(index, where, place or "", **known)


FIREFOX = playing(1, "Firefox", "firefox-esr", application_id="org.mozilla.firefox")
MPV = playing(2, "mpv Media Player", "mpv", "video")
GAME = playing(3, "Doom [shareware]", "doom", "game")
CHIME = playing(4, "Mail", "thunderbird", "event")
APPLICATIONS = (FIREFOX, MPV, GAME, CHIME)


def playing_now(*streams: Stream) -> ServerSnapshot:
    return snapshot(sinks=(sink(1, "desktop"), sink(2, "haptic")), sink_inputs=streams)


def selected(include: tuple[str, ...], exclude: tuple[str, ...] = ()) -> tuple[int, ...]:
    found = AppRules(include, exclude).select(playing_now(*APPLICATIONS), "haptic")
    return tuple(stream.index for stream in found)


NAMED = ("Firefox", "FIREFOX", " firefox ", "firefox-esr", "org.mozilla.firefox", "fire*")
RULES_OF = {
    (1,): (*NAMED, "binary:firefox-esr", "application:firefox", "application:org.mozilla.firefox"),
    (2,): ("m?v", "mpv Media Player", "role:video"),
    (3,): ("Role:Game", "Doom [shareware]", "application:doom*"),
    (2, 3, 4): ("role:*",),
    (1, 2, 3, 4): ("*",),
    (): ("binary:Firefox", "application:firefox-esr", "Fire", "video"),
}


@pytest.mark.parametrize(("rule", "found"), [(one, n) for n in RULES_OF for one in RULES_OF[n]])
def test_a_rule_matches_whole_names_of_any_case(rule, found):
    assert selected((rule,)) == found


def test_excluding_comes_before_including_and_a_name_may_have_a_colon_or_be_missing():
    assert (selected(()), selected((), ("role:event",))) == ((1, 2, 3, 4), (1, 2, 3))
    assert (selected(("mpv", "doom"), ("role:game",)), selected(("mpv",), ("*",))) == ((2,), ())
    one = playing(1, "Radio: live")
    assert AppRules(("application:Radio: live",)).select(playing_now(one)) == (one,)
    assert (app_name(playing(1, "", "mpv")), app_name(playing(1))) == ("mpv", "a song")


@pytest.mark.parametrize("rule", ["", " ", "binary:", "role: ", ":x", "name:mpv", "app:mpv", "a:b"])
def test_a_rule_that_is_empty_or_of_an_unknown_kind_is_refused(rule):
    for include, exclude in (((rule,), ()), ((), (rule,))):
        with pytest.raises(UsageError, match=r"rule .* for applications"):
            AppRules(include, exclude)


@pytest.mark.parametrize(
    "one",
    [
        playing(9, "mpv", "mpv", ROLE),
        playing(9, "mpv", "mpv", application_id=APPLICATION_ID),
        replace(MPV, index=9, properties={TAG: "17-1"}),
        replace(MPV, index=9, process_id=os.getpid()),
        playing(9, "mpv", "mpv", "abstract"),
        playing(9, "mpv", "mpv", "filter"),
        replace(MPV, index=9, properties={"node.link-group": "loopback-1-2"}),
        replace(MPV, index=9, properties={"pulse.module.id": "536870913"}),
        playing(9, "mpv", "mpv", place="haptic"),
        playing(9, "mpv", "mpv", place=None),
    ],
)
def test_ours_the_servers_own_and_the_haptic_sinks_are_never_captured(one):
    streams = playing_now(MPV, one)
    for rules in (AppRules(), AppRules(("mpv",)), AppRules(("*", "role:*", "binary:*"))):
        assert rules.select(streams, "haptic") == (MPV,)


def test_what_plays_on_a_sink_not_known_as_haptic_counts_and_who_is_paused_or_muted_stays():
    one = playing(9, "mpv", place="haptic")
    assert AppRules().select(playing_now(one)) == (one,)
    quiet = replace(MPV, corked=True, mute=True)
    assert AppRules(("mpv",)).select(playing_now(quiet), "haptic") == (quiet,)


@given(NAMES, NAMES)
def test_a_name_without_wildcards_matches_that_name_alone(rule, name):
    found = AppRules((f"application:{rule}",)).select(playing_now(playing(1, name)))
    assert bool(found) == (rule.casefold() == name.casefold())


@given(st.lists(st.sampled_from(APPLICATIONS), unique_by=lambda stream: stream.index), RULES, RULES)
def test_a_selection_keeps_the_order_and_more_rules_narrow_or_widen_it(streams, include, exclude):
    def chosen(include: list[str], exclude: list[str]) -> list[int]:
        found = AppRules(tuple(include), tuple(exclude)).select(playing_now(*streams))
        return [stream.index for stream in found]

    found = chosen(include, exclude)
    assert found == [stream.index for stream in streams if stream.index in found]
    assert set(chosen(include, [*exclude, "m*"])) <= set(found)
    if include:
        assert set(found) <= set(chosen([*include, "m*"], exclude))
        assert set(found) <= set(chosen([], exclude))


def reasons(streams, microphones, left_out=LeftOut()):  # noqa: B008 - immutable
    return [left_out.why(stream, microphones) for stream in streams]


def call_of(browser, server):
    return [made(browser, server, "call", what) for what in (PLAYING, RECORDING)]


def test_every_scene_was_recorded_with_its_film_and_microphone():
    for browser, server in FELT:
        recorded = SCENES[browser][server]
        assert recorded.keys() == RECORDED_SCENES.keys()
        for scene, streams in recorded.items():
            assert bool(streams[RECORDING]) == ("call" in scene or scene == "microphone")
        assert FELT[browser, server].keys() <= recorded.keys()


@pytest.mark.parametrize(("browser", "server", "scene"), scenes("pulse", "pipewire"))
def test_a_browsers_film_is_felt_and_its_call_is_not(browser, server, scene):
    playing, microphones = (made(browser, server, scene, what) for what in (PLAYING, RECORDING))
    call = CALL if browser == "firefox-esr" else MIXED
    films = felt(browser, server, scene)
    expected = ["" if at in films else call for at in range(len(playing))]
    assert reasons(playing, microphones) == expected
    assert not any(reasons(playing, ()))
    assert not any(reasons(playing, microphones, LeftOut(calls_and_alerts=True)))


@pytest.mark.parametrize("browser", SCENES)
def test_another_process_or_another_program_that_records_makes_no_call(browser):
    (call,), (microphone,) = call_of(browser, "pipewire")
    assert reasons([call], [replace(microphone, process_id=1), microphone]) != [""]
    assert reasons([call], [replace(microphone, process_id=1)]) == [""]
    assert reasons([call], [replace(microphone, application="Game")]) == [""]


@pytest.mark.parametrize("browser", SCENES)
@pytest.mark.parametrize(
    "more", [{"role": "Music"}, {"role": "game"}, {"properties": {"node.latency": "960/48000"}}]
)
def test_a_role_of_its_own_or_a_latency_of_20_ms_makes_a_stream_no_call(browser, more):
    (call,), microphones = call_of(browser, "pipewire")
    assert reasons([replace(call, **more)], microphones) == [""]


@pytest.mark.parametrize("latency", ["", "512", "512/0", "-1024/48000", "a/b", "959/48000"])
def test_a_latency_that_is_short_or_cannot_be_read_leaves_a_call_a_call(latency):
    (call,), microphones = call_of("firefox-esr", "pulse")
    assert reasons([replace(call, properties={"node.latency": latency})], microphones) == [CALL]
