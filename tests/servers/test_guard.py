"""Vibration is never to be heard from another sink than its own, whatever becomes of that one."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from device.server.guard import FallbackSink, Hold, StreamGuard, StreamPlacement
from device.server.identity import find_tagged, monitor_of
from device.stream.pcms import FALLBACK_SINK
from tests.servers import listening

TRIALS = 5


class RecordedGuard(StreamGuard):
    def __init__(self, connection, stream, name, holds):
        self._holds = holds
        super().__init__(connection, stream, name)

    def _judge(self, change: Callable[[], StreamPlacement]) -> None:
        before = getattr(self, "hold", None)
        super()._judge(change)
        if self.hold is not before and not self._released:
            self._holds.append(self.hold)


def guarded(pcms, connection, holds):
    """A stream with its guard, once that one has freed it."""
    stream = listening.open_output(pcms)
    return stream, freed(RecordedGuard(connection, stream, "haptic", holds))


def freed(guard):
    listening.wait_for(lambda: guard.hold is Hold.FREE, "freedom")
    return guard


def test_no_sample_is_heard_elsewhere_when_the_haptic_sink_goes(server, pcms, connection, tmp_path):
    refuge = FallbackSink(connection)
    assert bool(refuge._modules) == (server.kind == "pulse")

    def trial(folder: Path) -> None:
        folder.mkdir()
        with (
            listening.recording(server, "desktop.monitor", folder / "desktop") as heard,
            listening.recording(server, "haptic.monitor", folder / "haptic") as felt,
        ):
            stream, guard = guarded(pcms, connection, [])
            listening.wait_for(
                lambda: np.count_nonzero(felt()[-listening.RATE_HZ // 10 :]) > 4_000, "vibration"
            )
            server.remove("haptic")
            listening.wait_for(lambda: not guard.hold.audible, "silence", 1.0)
            assert not stream.audible
            listening.more(heard, 0.5)
            assert not np.count_nonzero(heard())
            assert guard.hold.misplaced
            assert not guard.hold.audible
            stream.close()
            guard.release()

    for number in range(TRIALS):
        trial(tmp_path / str(number))
        server.add_sink("haptic")  # with its sink back it is opened anew
    refuge.close()
    assert FALLBACK_SINK not in server.names("sinks")


def test_a_stream_that_is_moved_is_silenced_and_freed_when_it_is_back(server, pcms, connection):
    if server.kind == "pipewire":
        pytest.skip("PipeWire does not move a stream that must not reconnect")
    holds: list[Hold] = []
    stream, guard = guarded(pcms, connection, holds)
    assert stream.audible
    snapshot = connection.snapshot()
    ours = snapshot.sink_inputs[0]
    sinks = {sink.name: sink.index for sink in snapshot.sinks}
    connection.move_sink_input(ours.index, sinks["desktop"])
    listening.wait_for(lambda: guard.hold is Hold.ELSEWHERE, "the guard", 1.0)
    assert not stream.audible
    assert Hold.UNSETTLED in holds  # silenced before anything was asked
    connection.move_sink_input(ours.index, sinks["haptic"])
    listening.wait_for(lambda: guard.hold is Hold.FREE, "freedom", 1.0)
    assert stream.audible
    guard.release()
    assert not stream.audible
    assert stream.close()


def test_an_undisturbed_stream_is_never_silenced(server, pcms, connection):
    holds: list[Hold] = []
    stream, guard = guarded(pcms, connection, holds)
    listening.wait_for(lambda: stream.callbacks > 20, "callbacks")
    silenced, callbacks = stream.silenced, stream.callbacks
    server.add_sink("speakers")
    server.choose_default("speakers")
    server.pactl("set-sink-volume", "desktop", "40%")
    listening.wait_for(lambda: stream.callbacks > callbacks + 400, "callbacks")
    # after an underrun, of a busy machine, ALSA replaces the stream, which is then looked for
    underruns = len(holds) - holds.count(Hold.FREE)
    assert stream.silenced - silenced <= 2 + 8 * underruns, holds
    assert underruns < 10
    listening.wait_for(lambda: guard.hold is Hold.FREE, "freedom", 1.0)
    guard.release()
    assert stream.close()


def test_a_lost_server_means_silence(server, pcms, connection):
    stream, guard = guarded(pcms, connection, [])
    server.kill()
    listening.wait_for(lambda: guard.hold is Hold.LOST, "the loss", 2.0)
    assert not stream.audible
    guard.release()
    stream.close()


def test_a_refuge_left_over_is_taken_over(server, connection):
    if server.kind == "pipewire":
        pytest.skip("PipeWire needs no refuge")
    first, second = FallbackSink(connection), FallbackSink(connection)
    assert all(one._modules for one in (first, second))
    assert server.names("sinks").count(FALLBACK_SINK) == 1
    second.close()
    assert FALLBACK_SINK not in server.names("sinks")
    first.close()


def test_no_microphone_is_tapped_when_the_tapped_sink_vanishes(server, pcms, connection):
    server.add_microphone("microphone")
    loud = listening.noise(20.0)
    quiet = np.zeros_like(loud)

    def trial() -> None:
        collector = listening.Collector()
        stream = listening.open_tap(pcms, collector)
        with (
            listening.playing(server, "desktop", quiet),
            listening.playing(server, "microphone-room", loud),
        ):
            guard = freed(StreamGuard(connection, stream, "desktop.monitor"))
            listening.wait_for(lambda: len(collector.frames()) > listening.RATE_HZ // 4, "frames")
            server.remove("desktop")
            listening.wait_for(lambda: guard.hold.misplaced, "the guard", 1.0)
            listening.wait_seconds(0.5)
        stream.close()
        guard.release()
        leaked = np.count_nonzero(collector.frames().any(axis=1))
        assert leaked == 0, f"{leaked} frames of the microphone"

    for _ in range(TRIALS):
        trial()
        server.add_sink("desktop")


def test_a_tap_is_led_to_another_monitor(server, pcms, connection):
    server.add_sink("speakers")
    collector = listening.Collector()
    stream = listening.open_tap(pcms, collector, "desktop.monitor", audible=False)
    guard = freed(StreamGuard(connection, stream, "desktop.monitor"))
    snapshot = connection.snapshot()
    ours: Any = find_tagged(snapshot.source_outputs, stream.tag)
    with listening.playing(server, "speakers", listening.noise(10.0)):
        listening.wait_for(lambda: connection.snapshot().sink_inputs, "the player")
        assert not collector.frames().any()
        guard.retarget("speakers.monitor")
        assert guard.hold is Hold.ELSEWHERE
        connection.move_source_output(ours.index, monitor_of(snapshot, "speakers").index)
        listening.wait_for(lambda: collector.frames()[-256:].any(), "the other sink's sound", 3.0)
    assert stream.close()
    guard.release()


def test_a_microphone_frees_no_guard(server, pcms, connection):
    server.add_microphone("microphone")
    collector = listening.Collector()
    stream = listening.open_tap(pcms, collector, "microphone", audible=False)
    guard = StreamGuard(connection, stream, "microphone")
    with listening.playing(server, "microphone-room", listening.noise(5.0)):
        listening.wait_for(lambda: len(connection.snapshot().source_outputs) >= 1, "the tap")
        listening.wait_for(lambda: stream.callbacks > 100, "callbacks")
    assert guard.hold is Hold.NO_DEVICE
    assert not collector.frames().any()
    stream.close()
    guard.release()
