"""What needs no server: decisions of the guard, names, identities, configurations."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from device.errors import NotFoundError, UsageError
from device.server.forwarding import (
    SINK,
    Route,
    carries_sound_of,
    loopback_arguments,
    loopbacks,
    reachable_sinks,
    real_sinks,
    round_delay_ms,
)
from device.server.guard import Hold, StreamPlacement
from device.server.identity import (
    default_monitor,
    find_sink,
    find_source,
    identity_of,
    is_own_stream,
)
from device.server.snapshot import Event, ServerSnapshot, Sink, Source, Stream, _kind
from device.stream.pcms import FALLBACK_SINK, TAG, PcmConfig, ServerDevice


def sink(index: int, name: str, **properties: str) -> Sink:
    return Sink(index, name, name, f"{name}.monitor", 48_000, 2, None, properties)


def playback(index: int, place: int | None, **properties: str) -> Stream:
    return Stream(index, place, "", "", "", "", "", None, False, False, {TAG: "mine"} | properties)


def snapshot(*streams: Stream, events: int = 0, haptic: bool = True) -> ServerSnapshot:
    sinks = (sink(1, "desktop"), *((sink(2, "haptic"),) if haptic else ()))
    sources = (Source(1, "desktop.monitor", "", "desktop", 48_000, 2, {}),)
    return ServerSnapshot("PulseAudio", "16.1", "desktop", "", sinks, sources, streams, (), events)


PLACE = StreamPlacement("mine", "haptic")
HOME = PLACE.after_snapshot(snapshot(playback(7, 2), events=3))


@pytest.mark.parametrize(
    ("place", "hold"),
    [
        (PLACE, Hold.LOST),
        (HOME, Hold.FREE),
        (PLACE.after_snapshot(snapshot()), Hold.NO_STREAM),
        (PLACE.after_snapshot(snapshot(playback(7, 1))), Hold.ELSEWHERE),
        (PLACE.after_snapshot(snapshot(playback(7, None))), Hold.NO_STREAM),
        (PLACE.after_snapshot(snapshot(playback(7, 2), haptic=False)), Hold.NO_DEVICE),
        (HOME.after_event(Event("sink_input", "change", 7, 4)), Hold.UNSETTLED),
        (HOME.after_event(Event("sink_input", "remove", 7, 4)), Hold.NO_STREAM),
        (HOME.after_event(Event("sink", "remove", 2, 4)), Hold.NO_DEVICE),
        (HOME.after_event(Event("sink", "change", 2, 4)), Hold.FREE),
        (HOME.after_event(Event("sink_input", "change", 8, 4)), Hold.FREE),
        (HOME.after_event(Event("source", "remove", 2, 4)), Hold.FREE),
        (HOME.after_loss(), Hold.LOST),
        (HOME.after_loss().after_snapshot(snapshot(playback(7, 2))), Hold.FREE),
    ],
)
def test_vibration_is_felt_only_where_it_is_known_to_be(place: StreamPlacement, hold: Hold) -> None:
    assert place.hold is hold
    assert hold.audible == (hold is Hold.FREE)


def test_an_input_that_is_no_monitor_is_heard_for_measuring_alone() -> None:
    sources = (Source(4, "line-in", "", None, 48_000, 2, {}),)
    heard = (playback(7, 4),)
    there = ServerSnapshot("PulseAudio", "", "", "", (), sources, (), heard, 0)
    for any_source, hold in ((False, Hold.NO_DEVICE), (True, Hold.FREE)):
        place = StreamPlacement("mine", "line-in", plays=False, any_source=any_source)
        assert place.after_snapshot(there).hold is hold
    assert find_source(there, "line-in").index == 4
    with pytest.raises(NotFoundError, match="line-in"):
        find_source(there, "line-ni")


def test_a_snapshot_older_than_the_event_frees_nothing() -> None:
    moved = HOME.after_event(Event("sink_input", "change", 7, 5))
    stale = moved.after_snapshot(snapshot(playback(7, 2), events=4))
    assert stale.hold is Hold.UNSETTLED
    assert stale.after_snapshot(snapshot(playback(7, 2), events=5)).hold is Hold.FREE
    assert stale.after_snapshot(snapshot(playback(7, 1), events=5)).hold is Hold.ELSEWHERE


def test_a_name_that_is_not_there_offers_what_is() -> None:
    with pytest.raises(NotFoundError, match=r"^no sink 'haptik'; did you mean 'haptic'\?$"):
        find_sink(snapshot(), "haptik")
    with pytest.raises(NotFoundError, match=r"there are 'desktop', 'haptic'$"):
        find_sink(snapshot(), "qqqq")
    sinks = (sink(1, "desktop"), sink(2, FALLBACK_SINK))  # ours, and for nobody else
    with pytest.raises(NotFoundError, match=r"there are 'desktop'$"):
        find_sink(ServerSnapshot("PulseAudio", "16.1", "", "", sinks, (), (), (), 0), "qqqq")
    nothing = ServerSnapshot("PipeWire", "1", "", "", (), (), (), (), 0)
    with pytest.raises(NotFoundError, match="none was found"):
        find_sink(nothing, "x")
    with pytest.raises(NotFoundError, match="no default sink"):
        default_monitor(nothing)


def test_a_device_keeps_its_identity() -> None:
    dac = sink(
        1,
        "dac",
        **{
            "device.bus": "usb",
            "device.vendor.id": "0x0d8c",
            "device.product.id": "0014",
            "device.serial": "C-Media_Audio_A42",
            "device.bus_path": "pci-0000:00:14.0-usb-0:2:1.0",
            "alsa.card": "1",
        },
    )
    identity = identity_of(dac)
    assert (identity.vendor_id, identity.product_id, identity.alsa_card) == ("0d8c", "0014", "1")
    assert identity.is_usb("0D8C", "14")
    assert not identity.is_usb("0d8c", "0015")
    assert not identity_of(sink(1, "null")).is_usb("", "")


def test_a_stream_of_another_machine_with_our_process_id_is_not_ours() -> None:
    stream = Stream(1, 1, "", "", "", "", "", os.getpid(), False, False, {})
    assert is_own_stream(stream)
    there = {"application.process.host": "another-machine"}
    assert not is_own_stream(Stream(1, 1, "", "", "", "", "", os.getpid(), False, False, there))


def test_the_kind_of_a_server_is_in_its_name() -> None:
    assert _kind("pulseaudio", "16.1") == ("PulseAudio", "16.1")
    assert _kind("PulseAudio (on PipeWire 0.3.65)", "15.0.0") == ("PipeWire", "0.3.65")


def test_a_configuration_leads_where_it_should_and_restores_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PULSE_LATENCY_MSEC", "5")
    monkeypatch.setenv("PULSE_PROP", "a=b")
    before = dict(os.environ)
    config = PcmConfig("one", "two", folder=tmp_path)
    first = os.environ["ALSA_CONFIG_PATH"]
    assert "PULSE_LATENCY_MSEC" not in os.environ
    assert "pcm.one { type null }" in Path(first).read_text()
    config.pcms["one"].target = ServerDevice("haptic", "unix:/run/x")
    with config.opening(config.pcms["one"], "tag-1", output=True):
        path = os.environ["ALSA_CONFIG_PATH"]
        assert path != first
        text = Path(path).read_text().splitlines()
        assert text[0] == 'pcm.one { type pulse device "haptic" server "unix:/run/x" }'
        assert text[1:] == ["pcm.two { type null }", "pcm.default { type null }"]
        assert os.environ["PULSE_PROP"].startswith("a=b application.id=")
        assert f"{TAG}=tag-1" in os.environ["PULSE_PROP"]
    assert os.environ["PULSE_PROP"] == "a=b"
    config.close()
    assert dict(os.environ) == before
    assert list(tmp_path.iterdir()) == []


def test_quietening_leaves_python_its_voice() -> None:
    program = (
        "import ctypes, os, sys\n"
        "from device.stream.portaudio import filter_stderr\n"
        "print(filter_stderr(), filter_stderr())\n"
        "ctypes.CDLL(None).perror(b'library')\n"
        "os.write(2, b'ours\\n'); print('also ours', file=sys.stderr, flush=True)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        timeout=30,
    )
    if done.stdout.strip() == "False False":
        pytest.skip("needs the GNU C library")
    assert done.stdout.strip() == "True True"
    assert done.stderr.splitlines() == ["ours", "also ours"]


def test_neither_pulsectl_nor_pyaudio_is_loaded_by_importing_the_room() -> None:
    program = (
        "import sys, device.server; print([n for n in ('pulsectl', 'pyaudio') if n in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert done.stdout.strip() == "[]", done.stderr


def test_sound_cards_are_forwarded_to_first_and_nothing_of_ours_ever() -> None:
    sinks = (
        sink(1, "virtual"),
        sink(2, "card", **{"device.bus": "pci"}),
        sink(3, "haptic", **{"device.bus": "usb"}),
        sink(4, SINK),
        sink(5, FALLBACK_SINK),
    )
    there = ServerSnapshot("PulseAudio", "16.1", SINK, "", sinks, (), (), (), 0)
    assert real_sinks(there, "haptic") == ["card", "virtual"]
    assert real_sinks(there, None) == ["card", "haptic", "virtual"]


def made(index: int, place: int, device_name: str, module: int, **properties: str) -> Stream:
    names = ("", "", "", "")
    return Stream(index, place, device_name, *names, None, False, False, properties, module)


def test_what_a_sink_s_sound_comes_to_is_found_through_modules() -> None:
    first = made(1, 2, "second", 7)
    back = made(2, 4, SINK, 8)
    other = made(3, 4, SINK, 9)
    sinks = tuple(sink(index, name) for index, name in ((1, "first"), (2, "second"), (4, SINK)))
    sources = tuple(Source(one.index, one.monitor, "", one.name, 48_000, 2, {}) for one in sinks)
    taps = (made(1, 1, "first.monitor", 7), made(2, 2, "second.monitor", 8))
    there = ServerSnapshot(
        "PulseAudio", "", SINK, "", sinks, sources, (first, back, other), taps, 0
    )
    assert reachable_sinks(there, "first") == {"first", "second"}
    assert reachable_sinks(there, "second") == {"second"}
    assert carries_sound_of(there, back, {"first", "second"})
    assert not carries_sound_of(there, other, {"first", "second"})


def test_a_loopback_tells_its_route_and_whether_it_is_complete() -> None:
    route = Route("desktop", "speakers", 75)
    arguments = loopback_arguments(snapshot(), route, sink(4, SINK))
    told = next(text for text in arguments if text.startswith("sink_input_properties"))
    pairs = told.partition("=")[2].strip('"').replace("'Haptic Cushion'", "x").split()
    properties = {
        name: value.strip("'") for name, _, value in (pair.partition("=") for pair in pairs)
    }
    sinks = (sink(1, "desktop"), sink(4, SINK))
    sources = (Source(4, f"{SINK}.monitor", "", SINK, 48_000, 2, {}),)
    for playing, taps, complete in (
        ((made(1, 1, "desktop", 7, **properties),), (made(1, 4, "", 7, **properties),), True),
        ((made(1, 4, SINK, 7, **properties),), (made(1, 4, "", 7, **properties),), False),
        ((made(1, 1, "desktop", 7, **properties),), (), False),
        ((), (made(1, 4, "", 7, **properties),), False),
    ):
        there = ServerSnapshot("PulseAudio", "", SINK, "", sinks, sources, playing, taps, 0)
        (found,) = loopbacks(there)
        assert (found.module, found.route, found.complete) == (7, route, complete)


def test_a_route_that_no_module_could_take_is_refused() -> None:
    with pytest.raises(UsageError, match="quotes"):
        loopback_arguments(snapshot(), Route("it's", "desktop", 20), sink(4, SINK))
    with pytest.raises(UsageError, match=r"delay_s=-1\.0"):
        round_delay_ms(-1.0)
    with pytest.raises(UsageError, match="delay_s=nan"):
        round_delay_ms(float("nan"))
    assert [round_delay_ms(delay_s) for delay_s in (None, 0.0, 0.0754, 0.5)] == [20, 20, 75, 500]
