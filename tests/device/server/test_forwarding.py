"""Drop-in mode's sink and loopback, as a snapshot shows them."""

import re
from typing import Any

import pytest

from device.errors import UsageError
from device.server import forwarding
from device.server.forwarding import SINK, Route, carries_sound_of, loopback_arguments
from device.server.snapshot import Stream
from device.stream.pcms import FALLBACK_SINK
from tests.support.snapshots import monitor, sink, snapshot, stream


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
