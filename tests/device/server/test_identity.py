"""Devices are found by their exact names, and no microphone stands in for a monitor."""

import os

import pytest

from device.errors import NotFoundError
from device.server import identity
from device.server.identity import default_monitor, find_sink, identity_of, monitor_of
from device.server.snapshot import ServerSnapshot, Source, _kind
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
