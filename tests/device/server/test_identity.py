import math
import os
import re
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from device.errors import NotFoundError, UsageError
from device.server import defaults_check, forwarding, identity
from device.server.defaults_check import Defaults, DefaultsCheck
from device.server.forwarding import SINK, Route, carries_sound_of, loopback_arguments
from device.server.identity import default_monitor, find_sink, identity_of, monitor_of
from device.server.snapshot import ServerSnapshot, Source, Stream, _kind, decibels
from device.server.tap_volume import TapVolume, muted_sink
from device.stream.pcms import FALLBACK_SINK
from tests.support.snapshots import monitor, sink, snapshot, source, stream

SINKS = tuple(sink(index, name) for index, name in enumerate(("desktop", "desktop.2", "haptic")))
MONITORS = tuple(monitor(one, 10 + one.index) for one in SINKS)
MICROPHONE = source(5, "microphone")


def server(default: str = "desktop", *, sources: tuple[Source, ...] = MONITORS) -> ServerSnapshot:
    return snapshot(default_sink=default, sinks=SINKS, sources=(MICROPHONE, *sources))


def test_a_name_means_the_device_of_exactly_that_name():
    assert find_sink(server(), "desktop.2").name == "desktop.2"
    assert identity.find_source(server(), "microphone") is MICROPHONE
    assert monitor_of(server(), "desktop").name == "desktop.monitor"
    assert default_monitor(server("haptic")).name == "haptic.monitor"


@pytest.mark.parametrize("name", ["microphone", "desktop.monitor", "desk", ""])
def test_what_is_not_the_name_of_a_sink_is_never_tapped(name):
    with pytest.raises(NotFoundError, match="no sink"):
        monitor_of(server(), name)


def test_a_sink_without_a_monitor_and_a_default_that_is_missing_or_haptic_are_refused():
    for find in (lambda there: monitor_of(there, "desktop"), default_monitor):
        with pytest.raises(NotFoundError, match="has no monitor"):
            find(server(sources=MONITORS[1:]))
    for default, words in (("", "no default sink"), ("haptic", "feed back")):
        with pytest.raises(NotFoundError, match=words):
            default_monitor(server(default), "haptic")


@pytest.mark.parametrize(
    ("names", "wanted", "words"),
    [
        (("desktop", "haptic"), "haptik", r"^no sink 'haptik'; did you mean 'haptic'\?$"),
        (("desktop", "haptic"), "qqqq", r"there are 'desktop', 'haptic'$"),
        (("desktop", FALLBACK_SINK), "qqqq", r"there are 'desktop'$"),  # ours is not offered
        ((), "x", "none was found"),
    ],
)
def test_an_unknown_name_offers_the_known_ones(names, wanted, words):
    sinks = tuple(sink(index, name) for index, name in enumerate(names))
    with pytest.raises(NotFoundError, match=words):
        find_sink(snapshot(sinks=sinks), wanted)


def test_a_device_keeps_its_identity():
    known = {"device.vendor.id": "0x0d8c", "device.product.id": "0014"}
    known |= {"device.bus": "usb", "alsa.card": "1"}
    dac = identity_of(sink(1, "dac", known))
    assert (dac.vendor_id, dac.product_id, dac.alsa_card) == ("0d8c", "0014", "1")
    assert (dac.is_usb("0D8C", "14"), dac.is_usb("0d8c", "0015")) == (True, False)
    assert not identity_of(sink(1, "null")).is_usb("", "")


def test_a_stream_of_another_machine_is_not_ours_and_a_server_s_kind_is_in_its_name():
    assert identity.is_own_stream(stream(1, process_id=os.getpid()))
    there = {"application.process.host": "another-machine"}
    assert not identity.is_own_stream(stream(1, process_id=os.getpid(), properties=there))
    assert _kind("pulseaudio", "16.1") == ("PulseAudio", "16.1")
    assert _kind("PulseAudio (on PipeWire 0.3.65)", "15.0.0") == ("PipeWire", "0.3.65")


DESK = sink(1, "desk", volume_in_monitor=True)
MONITOR = monitor(DESK)
QUIET = replace(DESK, volume_db=-20.0)
FLAT = replace(QUIET, flat_volumes=True)
BY_THE_CARD = replace(QUIET, volume_in_monitor=False)
HALF = replace(MONITOR, volume=0.5)


def at(index: int, volume_db: float, **other: bool) -> Stream:
    return stream(index, 1, "desk", volume_db=volume_db, **other)


def followed(tap, *streams, sink=DESK, monitor=MONITOR):
    players = {one.index for one in streams if not one.corked}
    return tap.follow(snapshot(sinks=(sink,), sink_inputs=streams), players, monitor)


@pytest.mark.parametrize(
    ("sink", "monitor", "stream_db", "volume_db"),
    [
        (QUIET, HALF, -3.0, -23.0 + decibels(0.5)),  # all add up
        (BY_THE_CARD, MONITOR, -3.0, -3.0),
        (QUIET, None, -3.0, -3.0),  # the stream is captured by itself
        (FLAT, MONITOR, -23.0, -23.0),  # the stream's volume contains that of the sink
        (FLAT, None, -23.0, -3.0),
    ],
)
def test_volumes_that_the_sound_has_passed_add_up_once_each(sink, monitor, stream_db, volume_db):
    found_db = followed(TapVolume(), at(7, stream_db), sink=sink, monitor=monitor)
    assert found_db == pytest.approx(volume_db)


@pytest.mark.parametrize(("music_db", "added_db", "volume_db"), [(-20, 0, -20), (-78, 0, 0)])
def test_a_notification_changes_nothing_unless_music_is_at_5_percent(music_db, added_db, volume_db):
    tap, music = TapVolume(), at(9, music_db)
    assert (followed(tap, music), followed(tap, at(3, added_db), music)) == (music_db, volume_db)
    assert followed(tap, music) == music_db


@pytest.mark.parametrize(
    ("then", "volume_db"),
    [
        (at(7, -20.0, corked=True), -20.0),
        (at(8, -5.0), -5.0),
        (at(7, -math.inf), -20.0),
        (at(7, 0.0, mute=True), -20.0),
    ],
)
def test_the_volume_stays_until_another_stream_is_heard(then, volume_db):
    tap = TapVolume()
    followed(tap, at(7, -20.0))
    assert followed(tap, then) == volume_db


def test_the_servers_scale_is_cubic():
    assert decibels(1.0) == 0.0
    assert decibels(0.5) == pytest.approx(-18.06, abs=0.01)  # what pactl says of 50 %
    assert decibels(0.0) == -math.inf


@pytest.mark.parametrize(
    ("sink", "name"),
    [
        (DESK, ""),
        (replace(DESK, mute=True), "desk"),
        (replace(DESK, volume_db=-math.inf), "desk"),
        (replace(DESK, mute=True, volume_in_monitor=False), "desk"),
        (replace(DESK, name="other", mute=True), ""),
    ],
)
def test_a_muted_sink_is_named_whether_its_monitor_is_silent_or_not(sink, name):
    assert muted_sink(snapshot(sinks=(sink,)), MONITOR.monitor_of) == name


def made(index: int, place: int, device_name: str, module: int, **properties: str) -> Stream:
    return stream(index, place, device_name, module=module, properties=properties)


def test_sound_cards_are_forwarded_to_first_and_nothing_of_ours_ever():
    cards = sink(2, "card", {"device.bus": "pci"}), sink(3, "haptic", {"device.bus": "usb"})
    sinks = (sink(1, "virtual"), *cards, sink(4, SINK), sink(5, FALLBACK_SINK))
    for haptic, names in (("haptic", ["card", "virtual"]), (None, ["card", "haptic", "virtual"])):
        assert forwarding.real_sinks(snapshot(sinks=sinks), haptic) == names


def test_sinks_that_a_sound_reaches_are_found_through_modules():
    back, other = made(2, 4, SINK, 8), made(3, 4, SINK, 9)
    sinks = (sink(1, "first"), sink(2, "second"), sink(4, SINK))
    taps = made(1, 1, "first.monitor", 7), made(2, 2, "second.monitor", 8)
    streams: Any = {"sink_inputs": (made(1, 2, "second", 7), back, other), "source_outputs": taps}
    seen = snapshot(sinks=sinks, sources=tuple(map(monitor, sinks)), **streams)
    for sound, reached in (("first", {"first", "second"}), ("second", {"second"})):
        assert forwarding.reachable_sinks(seen, sound) == reached
    assert carries_sound_of(seen, back, {"first", "second"})
    assert not carries_sound_of(seen, other, {"first", "second"})


def test_a_loopback_reports_its_route_and_whether_it_is_complete():
    route = Route("desktop", "speakers", 75)
    arguments = loopback_arguments(snapshot(), route, sink(4, SINK))
    listed = next(text for text in arguments if text.startswith("sink_input_properties"))
    pairs = re.findall(r"([\w.-]+)=('[^']*'|[^'\s]+)", listed.partition("=")[2].strip('"'))
    properties = {name: value.strip("'") for name, value in pairs}
    tap = made(1, 4, "", 7, **properties)
    out = made(1, 1, "desktop", 7, **properties)
    moved = made(1, 4, SINK, 7, **properties)
    cases = [((out,), (tap,), True), ((moved,), (tap,), False), ((out,), (), False)]
    for playing, taps, complete in (*cases, ((), (tap,), False)):
        own, streams = sink(4, SINK), dict[str, Any](sink_inputs=playing, source_outputs=taps)
        seen = snapshot(sinks=(sink(1, "desktop"), own), sources=(monitor(own),), **streams)
        (found,) = forwarding.loopbacks(seen)
        assert (found.module, found.route, found.complete) == (7, route, complete)


def test_a_route_that_no_module_could_take_is_refused():
    with pytest.raises(UsageError, match="quotes"):
        loopback_arguments(snapshot(), Route("it's", "desktop", 20), sink(4, SINK))
    for wrong in (-1.0, float("nan")):
        with pytest.raises(UsageError, match=f"delay_s={wrong}"):
            forwarding.round_delay_ms(wrong)
    told = [forwarding.round_delay_ms(delay_s) for delay_s in (None, 0.0, 0.0754, 0.5)]
    assert told == [20, 20, 75, 500]


def due_s(*changes_s: float, kind: str = "PipeWire") -> float | None:
    check = DefaultsCheck(lambda known: None)
    for now_s in changes_s:
        check.note_change(float(now_s), snapshot(kind=kind))
    return check.due_s


def test_the_check_waits_for_calm_but_not_for_ever_and_pulseaudio_needs_none():
    assert due_s(10.0, kind="PulseAudio") is None
    assert due_s(10.0, 10.5, 11.0) == 11.0 + defaults_check.AFTER_S
    assert due_s(*np.arange(10.0, 30.0, 0.1)) == 10.0 + defaults_check.AT_MOST_S


KNOWN, NEW, NEWER = Defaults("desktop", ""), Defaults("speakers", ""), Defaults("hdmi", "")


@pytest.fixture
def checked(monkeypatch):
    """Checks against these answers of new connections, and what was reported."""
    monkeypatch.setattr(defaults_check, "AGAIN_S", 0.0)
    reported: list[Defaults] = []
    check = DefaultsCheck(reported.append)

    def run(*answers: Defaults | None) -> tuple[int, float]:
        """How often outdated defaults were reported, and in how many s they may be again."""
        left = iter(answers)
        monkeypatch.setattr(defaults_check, "fetch_defaults", lambda: next(left))
        check.check(KNOWN)
        check.note_change(now_s := time.monotonic(), snapshot(kind="PipeWire"))
        assert check.due_s is not None
        again_s, check.due_s = check.due_s - now_s, None
        return len(reported), again_s

    return run


def test_two_new_connections_that_agree_outdate_the_known_defaults(checked):
    assert (checked(KNOWN)[0], checked(NEW, NEW)[0]) == (0, 1)


def test_a_change_in_progress_or_a_server_without_an_answer_is_asked_again(checked):
    assert checked(None, NEW, NEWER, NEWER, NEWER)[0] == 1
    assert checked(NEW, None, KNOWN)[0] == 1  # none more


def test_outdated_defaults_are_reported_soon_but_ever_less_often_where_that_does_not_help(checked):
    waits_s = [checked(NEW, NEW)[1] for _ in range(6)]
    again_s, most_s = defaults_check.RENEW_AGAIN_S, defaults_check.RENEW_AT_MOST_S
    wanted_s = [min(again_s * 2.0**number, most_s) for number in range(6)]
    assert waits_s == pytest.approx(wanted_s, abs=0.5)
    checked(KNOWN)
    assert checked(NEW, NEW)[1] == pytest.approx(again_s, abs=0.5)
