"""The guard's rule: a stream is audible only while it is known to be on its own device."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.errors import LostError
from device.server import PulseConnection
from device.server.guard import Hold, StreamGuard, StreamPlacement
from device.server.snapshot import Event, ServerSnapshot, Stream
from device.stream.pcms import TAG
from device.stream.streams import PlaybackStream
from tests.support.snapshots import monitor, sink, snapshot, source, stream

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
