"""Devices are found by their exact names, and no microphone stands in for a monitor."""

import pytest

from device.errors import NotFoundError
from device.server.identity import default_monitor, find_sink, find_source, monitor_of
from device.server.snapshot import ServerSnapshot, Sink, Source

SINKS = tuple(
    Sink(index, name, name, f"{name}.monitor", 48_000, 2, None, {})
    for index, name in enumerate(("desktop", "desktop.2", "haptic"), 1)
)
MONITORS = tuple(
    Source(10 + sink.index, sink.monitor, sink.name, sink.name, 48_000, 2, {}) for sink in SINKS
)
MICROPHONE = Source(5, "microphone", "Microphone", None, 48_000, 2, {})


def server(default_sink: str = "desktop", *, sources: tuple[Source, ...] = MONITORS):
    everything = (MICROPHONE, *sources)
    return ServerSnapshot(
        "PipeWire", "1.0", default_sink, "microphone", SINKS, everything, (), (), 0
    )


def test_a_name_means_the_device_of_exactly_that_name():
    assert find_sink(server(), "desktop.2").name == "desktop.2"
    assert find_source(server(), "microphone") is MICROPHONE
    assert monitor_of(server(), "desktop").name == "desktop.monitor"
    assert default_monitor(server("haptic")).name == "haptic.monitor"


@pytest.mark.parametrize("name", ["microphone", "desktop.monitor", "desk", ""])
def test_what_is_not_the_name_of_a_sink_is_never_tapped(name):
    with pytest.raises(NotFoundError, match="no sink"):
        monitor_of(server(), name)


def test_a_sink_without_a_monitor_gets_no_other_source():
    with pytest.raises(NotFoundError, match="has no monitor"):
        monitor_of(server(sources=MONITORS[1:]), "desktop")
    with pytest.raises(NotFoundError, match="has no monitor"):
        default_monitor(server(sources=MONITORS[1:]))


def test_a_default_sink_that_is_missing_or_haptic_is_refused():
    with pytest.raises(NotFoundError, match="no default sink"):
        default_monitor(server(""))
    with pytest.raises(NotFoundError, match="feed back"):
        default_monitor(server("haptic"), "haptic")
