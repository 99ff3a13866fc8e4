"""Rules select the applications that a user means; calls and what must not be captured are out."""

import os
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.errors import UsageError
from device.server.app_rules import AppRules, app_name
from device.server.left_out import CALL, MIXED, LeftOut
from device.server.snapshot import ServerSnapshot, Stream
from device.stream.pcms import APPLICATION_ID, ROLE, TAG
from tests.support.browser_streams import FELT, PLAYING, RECORDING, SCENES, felt, made, scenes
from tests.support.snapshots import sink, snapshot, stream
from tools.browser_streams import SCENES as RECORDED_SCENES

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
