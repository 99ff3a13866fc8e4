"""The volume that a tap's sound carries, from snapshots of the server."""

import math
from dataclasses import replace

import pytest

from device.server.snapshot import Stream, decibels
from device.server.tap_volume import TapVolume, muted_sink
from tests.support.snapshots import monitor, sink, snapshot, stream

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
