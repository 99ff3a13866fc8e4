"""The volume that a tap's sound carries, from snapshots of the server."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from device.server.snapshot import Sink, Source, Stream, decibels
from device.server.tap_volume import TapVolume, muted_sink
from tests.support.snapshots import monitor, sink, snapshot, stream

DESK = sink(1, "desk", volume_in_monitor=True)
MONITOR = monitor(DESK)


def at(index: int, volume_db: float, **other: bool) -> Stream:
    return stream(index, 1, "desk", volume_db=volume_db, **other)


def followed(
    tap: TapVolume, *streams: Stream, sink: Sink = DESK, monitor: Source | None = MONITOR
) -> float:
    players = {one.index for one in streams if not one.corked}
    return tap.follow(snapshot(sinks=(sink,), sink_inputs=streams), players, monitor)


def test_volumes_of_stream_sink_and_monitor_add_up() -> None:
    sink, monitor = replace(DESK, volume_db=-20.0), replace(MONITOR, volume=0.5)
    volume_db = followed(TapVolume(), at(7, -3.0), sink=sink, monitor=monitor)
    assert volume_db == pytest.approx(-23.0 + decibels(0.5))


def test_a_sink_counts_only_where_its_monitor_carries_its_volume() -> None:
    by_the_card = replace(DESK, volume_db=-20.0, volume_in_monitor=False)
    assert followed(TapVolume(), at(7, -3.0), sink=by_the_card) == -3.0


def test_streams_captured_by_themselves_carry_no_volume_of_the_sink() -> None:
    sink = replace(DESK, volume_db=-20.0)
    assert followed(TapVolume(), at(7, -3.0), sink=sink, monitor=None) == -3.0


def test_flat_volumes_of_streams_contain_that_of_the_sink_once() -> None:
    sink = replace(DESK, volume_db=-20.0, flat_volumes=True)
    assert followed(TapVolume(), at(7, -23.0), sink=sink) == pytest.approx(-23.0)
    assert followed(TapVolume(), at(7, -23.0), sink=sink, monitor=None) == pytest.approx(-3.0)


def test_a_notification_over_music_changes_nothing() -> None:
    tap = TapVolume()
    music = at(9, -20.0)
    assert followed(tap, music) == -20.0
    assert followed(tap, at(3, 0.0), music) == -20.0
    assert followed(tap, music) == -20.0


def test_the_volume_is_that_of_the_next_stream_once_the_first_has_ended() -> None:
    tap = TapVolume()
    followed(tap, at(7, -20.0))
    assert followed(tap, at(7, -20.0, corked=True)) == -20.0
    assert followed(tap, at(8, -5.0)) == -5.0


@pytest.mark.parametrize("volume_db", [-math.inf, 0.0])
def test_silenced_streams_do_not_count(volume_db: float) -> None:
    tap = TapVolume()
    followed(tap, at(7, -20.0))
    muted = at(7, volume_db, mute=volume_db == 0.0)
    assert followed(tap, muted) == -20.0


def test_the_servers_scale_is_cubic() -> None:
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
def test_a_muted_sink_is_named_whether_its_monitor_is_silent_or_not(sink: Sink, name: str) -> None:
    assert muted_sink(snapshot(sinks=(sink,)), MONITOR.monitor_of) == name


def test_a_stream_at_5_percent_does_not_make_another_one_far_too_strong() -> None:
    tap = TapVolume()
    quiet, full = at(7, -78.0), at(9, 0.0)
    assert followed(tap, quiet) == -78.0
    assert followed(tap, quiet, full) == 0.0
    assert followed(tap, quiet) == -78.0
