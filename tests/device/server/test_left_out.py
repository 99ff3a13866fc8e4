"""Which of a browser's streams are left out, for streams that browsers really made."""

from dataclasses import replace

import pytest

from device.server.left_out import CALL, MIXED, LeftOut
from tests.support.browser_streams import FELT, PLAYING, RECORDING, SCENES, felt, made, scenes
from tools.browser_streams import SCENES as RECORDED_SCENES


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
