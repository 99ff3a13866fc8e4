"""The guard's rule: a stream is audible only while it is known to be on its own device."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.errors import LostError
from device.server import PulseConnection
from device.server.guard import Hold, StreamGuard, StreamPlacement
from device.server.snapshot import Event, ServerSnapshot, Sink, Source, Stream
from device.stream.pcms import TAG
from device.stream.streams import PlaybackStream

OUR_SINK, OTHER_SINK, OUR_STREAM, OTHER_STREAM = 1, 2, 10, 11
MICROPHONE, MONITOR = 3, 4


def sink(index: int, name: str) -> Sink:
    return Sink(index, name, name, f"{name}.monitor", 48_000, 2, None, {}, "")


def stream(index: int, on: int | None, tag: str = "ours") -> Stream:
    properties = {TAG: tag}
    return Stream(index, on, "", "", "", "", "", None, False, False, properties)


def snapshot(on: int | None, events: int = 0, **changes: Any) -> ServerSnapshot:
    known = ServerSnapshot(
        kind="PulseAudio",
        version="16.1",
        default_sink="speakers",
        default_source="microphone",
        sinks=(sink(OUR_SINK, "dac"), sink(OTHER_SINK, "speakers")),
        sources=(
            Source(MICROPHONE, "microphone", "", None, 48_000, 2, {}, ""),
            Source(MONITOR, "speakers.monitor", "", "speakers", 48_000, 2, {}, ""),
        ),
        sink_inputs=(stream(OTHER_STREAM, OTHER_SINK, "other"), stream(OUR_STREAM, on)),
        source_outputs=(),
        events=events,
    )
    return replace(known, **changes)


def event(number: int, kind: str, facility: str, index: int) -> Event:
    return Event(facility, kind, index, number)


PLACED = StreamPlacement("ours", "dac").after_snapshot(snapshot(OUR_SINK))


def test_on_its_device_it_may_sound_and_elsewhere_it_may_not() -> None:
    assert PLACED.hold is Hold.FREE
    assert PLACED.after_snapshot(snapshot(OTHER_SINK)).hold is Hold.ELSEWHERE
    assert PLACED.after_snapshot(snapshot(None)).hold is Hold.NO_STREAM
    assert PLACED.after_snapshot(snapshot(OUR_SINK, sink_inputs=())).hold is Hold.NO_STREAM
    assert PLACED.after_snapshot(snapshot(OUR_SINK, sinks=())).hold is Hold.NO_DEVICE
    assert PLACED.after_loss().hold is Hold.LOST
    assert StreamPlacement("ours", "dac").hold is Hold.LOST


@pytest.mark.parametrize(
    ("kind", "facility", "index"),
    [
        ("change", "sink_input", OUR_STREAM),
        ("remove", "sink_input", OUR_STREAM),
        ("remove", "sink", OUR_SINK),
    ],
)
def test_an_event_silences_until_a_look_that_is_not_older(
    kind: str, facility: str, index: int
) -> None:
    moved = PLACED.after_event(event(7, kind, facility, index))
    assert not moved.hold.audible
    assert not moved.after_snapshot(snapshot(OUR_SINK, events=6)).hold.audible
    assert moved.after_snapshot(snapshot(OUR_SINK, events=7)).hold is Hold.FREE


def test_events_of_others_silence_nothing() -> None:
    for one in (
        event(7, "change", "sink_input", OTHER_STREAM),
        event(8, "remove", "sink", OTHER_SINK),
        event(9, "change", "sink", OUR_SINK),
    ):
        assert PLACED.after_event(one).hold is Hold.FREE


def test_a_microphone_is_never_the_device_of_a_tap_but_its_monitor_is() -> None:
    taps = (stream(OUR_STREAM, MICROPHONE), stream(OTHER_STREAM, MONITOR, "tap"))
    seen = snapshot(OUR_SINK, source_outputs=taps)
    microphone = StreamPlacement("ours", "microphone", plays=False)
    assert microphone.after_snapshot(seen).hold is Hold.NO_DEVICE
    monitor = StreamPlacement("tap", "speakers.monitor", plays=False)
    assert monitor.after_snapshot(seen).hold is Hold.FREE
    any_source = replace(microphone, any_source=True)
    assert any_source.after_snapshot(seen).hold is Hold.FREE


@given(st.lists(st.sampled_from(["here", "there", "event", "lost"]), max_size=12))
def test_the_stream_is_audible_exactly_while_the_last_word_was_that_it_is_here(
    story: list[str],
) -> None:
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
            on = OUR_SINK if word == "here" else OTHER_SINK
            guard.on_snapshot(snapshot(on, events=number))
        known = word == "here"
        assert playback.audible == known
    guard.release()
    guard.on_snapshot(snapshot(OUR_SINK, events=number))
    assert not playback.audible
    assert not listeners
