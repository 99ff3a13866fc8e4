"""What a connection knows, notices and changes, and what it says when the server is gone."""

import gc
import threading
import time
from typing import Any

import pytest

from audioflinger_hook.daemon.reconnecting_stream import ReconnectingStream
from audioflinger_hook.service.state import Cause, StateKeeper
from device.errors import InternalError, LostError, NotFoundError
from device.server import defaults_check, identity
from device.server.connection_thread import ANSWER_LIMIT_S
from device.server.pulse import PulseConnection
from device.server.snapshot import Listener, ServerSnapshot
from device.stream.pcms import APPLICATION_NAME, ROLE
from tests.servers.listening import (
    Collector,
    insist_on_default,
    noise,
    open_output,
    open_tap,
    playing,
    wait_for,
    wait_seconds,
)
from tests.support.commands import open_files


def connections_made(monkeypatch: pytest.MonkeyPatch) -> list[PulseConnection]:
    """A list that gets every connection that is made from now on, also again."""
    made: list[PulseConnection] = []
    connect = PulseConnection._connect

    def counted(self: PulseConnection) -> None:
        made.append(self)
        connect(self)

    monkeypatch.setattr(PulseConnection, "_connect", counted)
    return made


def test_a_snapshot_says_what_the_server_holds_and_a_new_connection_its_default_devices(
    server, connection, monkeypatch
):
    snapshot = connection.snapshot()
    assert snapshot.kind == {"pulse": "PulseAudio", "pipewire": "PipeWire"}[server.kind]
    assert snapshot.version[0].isdecimal()
    assert snapshot.default_sink == "desktop"
    assert {sink.name for sink in snapshot.sinks} == {"desktop", "haptic"}
    haptic = identity.find_sink(snapshot, "haptic")
    assert (haptic.samplerate, haptic.channels, haptic.monitor) == (48_000, 2, "haptic.monitor")
    assert identity.monitor_of(snapshot, "haptic").name == "haptic.monitor"
    server.add_sink("speakers")
    server.choose_default("speakers")
    wait_for(
        lambda: (now := defaults_check.fetch_defaults()) and now.sink == "speakers", "the sink"
    )
    monkeypatch.setenv("PULSE_SERVER", "unix:/nowhere")
    assert defaults_check.fetch_defaults() is None


def test_applications_are_listed_with_process_binary_and_role(server, connection):
    with playing(server, "desktop", noise(5.0)) as process_id:
        wait_for(
            lambda: any(item.device_name for item in connection.snapshot().sink_inputs),
            "the player",
        )
        (stream,) = connection.latest.sink_inputs
        assert (stream.application, stream.binary, stream.role) == ("Player", "pacat", "music")
        assert (stream.process_id, stream.device_name) == (process_id, "desktop")
        assert not identity.is_own_stream(stream)
    wait_for(lambda: not connection.latest.sink_inputs, "the end of the stream")


def test_our_own_streams_are_known_and_tap_no_microphone(server, pcms, connection):
    server.add_microphone("microphone")
    wait_for(lambda: connection.snapshot().default_source == "microphone", "the microphone")
    capture = open_tap(pcms, Collector(), identity.default_monitor(connection.latest).name)
    playback = open_output(pcms)
    wait_for(lambda: capture.callbacks > 5, "callbacks")
    snapshot = connection.snapshot()
    plays: Any = identity.find_tagged(snapshot.sink_inputs, playback.tag)
    records: Any = identity.find_tagged(snapshot.source_outputs, capture.tag)
    assert identity.is_own_stream(plays)
    assert [*filter(identity.is_own_stream, snapshot.source_outputs)] == [records]
    assert (plays.application, plays.role, plays.device_name) == (APPLICATION_NAME, ROLE, "haptic")
    assert records.device_name == "desktop.monitor"
    assert identity.find_tagged(snapshot.sink_inputs, capture.tag) is None
    assert capture.close()
    assert playback.close()
    wait_for(lambda: not connection.latest.sink_inputs, "the end of the stream")


def test_another_default_sink_is_told_within_half_a_second(server, connection, notes, monkeypatch):
    anew = connections_made(monkeypatch)
    server.add_sink("speakers")
    for _ in range(3):
        server.choose_default("speakers")
        changed_s = time.monotonic()
        wait_for(lambda: notes.defaults, "the news", 5.0)
        assert notes.defaults[0][1] == "speakers"
        took_s = notes.defaults[0][0] - changed_s
        if not anew:
            break
        # Asked again, PipeWire still told this connection the default sink of before.
        insist_on_default(server, connection, "desktop")
        wait_for(lambda: notes.defaults[-1][1] == "desktop", "its being told")
        notes.defaults.clear()
        anew.clear()
    assert took_s < 0.5
    assert identity.default_monitor(connection.latest).name == "speakers.monitor"
    # there and back again within the time it has to settle: the other is not told
    server.choose_default("desktop")
    server.choose_default("speakers")
    server.pactl("set-sink-volume", "desktop", "50%")
    wait_for(lambda: notes.snapshots[-1].default_sink == "speakers", "the old default")
    wait_seconds(0.4)
    assert {name for _, name in notes.defaults} == {"speakers"}


def test_a_connection_that_is_told_a_wrong_default_is_made_anew(server, monkeypatch, notes):
    if server.kind != "pipewire":
        pytest.skip("only PipeWire tells one connection this and another one that")
    told = defaults_check.Defaults("speakers", "desktop.monitor")
    monkeypatch.setattr(defaults_check, "fetch_defaults", lambda: told)
    connected = connections_made(monkeypatch)
    connection = PulseConnection(notes)
    try:
        wait_for(lambda: len(connected) == 2, "another connection")
        server.add_sink("speakers")
        server.choose_default("speakers")
        wait_for(lambda: connection.latest.default_sink == "speakers", "the new default sink")
        wait_for(lambda: notes.defaults and notes.defaults[-1][1] == "speakers", "its being told")
        assert connection.lost is None
    finally:
        connection.close()


def test_modules_are_loaded_and_what_is_gone_is_an_error(server, pcms, connection):
    stream = open_output(pcms)
    ours: Any = identity.find_tagged(connection.snapshot().sink_inputs, stream.tag)
    sink = identity.find_sink(connection.latest, "haptic")
    assert stream.close()
    wait_for(lambda: not connection.snapshot().sink_inputs, "the end of the stream")
    with pytest.raises(NotFoundError, match="is gone"):
        connection.move_sink_input(ours.index, sink.index)
    index = connection.load_module("module-null-sink", ["sink_name=third"])
    wait_for(lambda: "third" in server.names("sinks"), "the sink")
    assert connection.modules()[index] == "module-null-sink"
    connection.unload_module(index)
    wait_for(lambda: "third" not in server.names("sinks"), "the end of the sink")
    with pytest.raises(NotFoundError):
        connection.load_module("module-that-is-not-there")


def test_no_stream_is_opened_on_a_device_that_has_vanished(server, connection):
    causes = Cause.DEVICE_LOST, Cause.DEVICE_MOVED
    output = ReconnectingStream[Any]("the output", StateKeeper(0.0), *causes)
    server.remove("haptic")
    wait_for(lambda: "haptic" not in server.names("sinks"), "its end")
    with pytest.raises(NotFoundError, match="no device 'haptic' any more"):
        output.open(pytest.fail, connection, "haptic", 0.0)


def test_a_killed_server_is_told_and_another_connection_is_made(server, connection, notes):
    server.kill()
    wait_for(lambda: notes.lost, "the loss", 2.0)
    with pytest.raises(LostError, match="was lost"):
        connection.snapshot()
    with pytest.raises(LostError, match=r"no sound server answers at unix:.*; start PulseAudio"):
        PulseConnection()
    server.start()
    again = PulseConnection()
    assert identity.find_sink(again.latest, "haptic").name == "haptic"
    again.close()
    with pytest.raises(LostError, match="closed"):
        again.snapshot()
    assert len(notes.lost) == 1


def test_a_server_that_hangs_counts_as_lost(server, connection, notes):
    server.pause()
    asked_s = time.monotonic()
    with pytest.raises(LostError, match="does not answer"):
        connection.snapshot()
    assert time.monotonic() - asked_s < 2 * ANSWER_LIMIT_S + 0.5
    wait_for(lambda: notes.lost, "the loss", 1.0)
    with pytest.raises(LostError):
        PulseConnection()
    server.resume()
    connection.close()


def test_snapshots_follow_events_and_a_listener_may_not_ask(server, connection, notes):
    class Refused(Listener):
        def on_snapshot(self, snapshot: ServerSnapshot) -> None:
            try:
                connection.snapshot()
            except InternalError as error:
                refused.add(str(error))

    refused: set[str] = set()
    connection.add(Refused())
    server.add_sink("speakers")
    wait_for(lambda: any(sink.name == "speakers" for sink in connection.latest.sinks), "the sink")
    assert ("sink", "new") in {(event.facility, event.kind) for event in notes.events}
    assert refused == {"the connection's thread must not query the connection"}
    assert notes.events[-1].number >= len(notes.events)
    assert connection.latest.events <= notes.events[-1].number


def test_connections_leave_nothing_behind(server):
    def held() -> tuple[int, int]:
        gc.collect()
        return threading.active_count(), open_files()

    PulseConnection().close()
    before = held()
    for _ in range(20):
        connection = PulseConnection()
        connection.snapshot()
        connection.close()
        connection.close()
    del connection
    wait_for(lambda: held() == before, f"return to {before}", 3.0)
