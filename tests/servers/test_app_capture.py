"""Each application is captured by itself, unchanged, and nothing else ever is."""

import gc
import random
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from device.errors import InternalError, LostError, NotFoundError
from device.server.app_capture import AppCapture, EndReason
from device.server.app_captures import AppCaptures
from device.server.app_rules import AppRules
from device.server.connection_thread import ANSWER_LIMIT_S
from device.server.guard import FallbackSink
from device.server.identity import find_tagged, is_own_stream
from device.server.pulse import PulseConnection
from device.server.snapshot import Stream
from device.stream.pcms import APPLICATION_NAME, ROLE
from device.units import Float32Array
from tests.servers.daemons import environment, program
from tests.servers.listening import (
    ATTEMPTS,
    RATE_HZ,
    Collector,
    noise,
    playing,
    sounding,
    wait_for,
    wait_seconds,
)
from tests.support.commands import open_files
from tools.sound_server import ServerError

LEVEL = 0.4
MICROPHONE_HZ = 1_000
SILENT = 1e-3 * LEVEL  # 60 dB under the level of the tones


class Player:
    """A running `tests.servers.player`; index: of its stream."""

    def __init__(self, process: Any) -> None:
        self.process = process
        self.index = int(process.stdout.readline())

    def tell(self, what: str) -> None:
        self.process.stdin.write(f"{what}\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline().strip() == what

    def end(self) -> None:
        self.process.kill()
        self.process.wait(5.0)


@contextmanager
def tone(server, hz, sink="desktop", level=LEVEL):
    command = (sys.executable, "-m", "tests.servers.player", str(hz), str(level), sink)
    with program(environment(server), *command, stdin=subprocess.PIPE) as process:
        yield Player(process)


@pytest.fixture
def apps(server):
    apps = AppCaptures()
    yield apps
    assert apps.close()


def captured(apps, player):
    """A capture of a player's stream, and where its frames go."""
    collector = Collector()
    return apps.open(player.index, RATE_HZ, 2, collector), collector


def amplitude(frames: Float32Array, hz: int) -> float:
    window = np.hanning(len(frames))
    wave = np.exp(-2j * np.pi * hz * np.arange(len(frames)) / RATE_HZ)
    return float(2.0 * abs(np.sum(frames[:, 0] * window * wave)) / window.sum())


def last(collector: Collector, seconds: float = 0.5) -> Float32Array:
    """The end of what was captured, once there are so many frames from now on."""
    count = int(seconds * RATE_HZ)
    before = len(collector.frames())
    wait_for(lambda: len(collector.frames()) >= before + count, "frames")
    return collector.frames()[-count:]


def steady(collector: Collector, hz: int) -> float:
    """The tone's amplitude in the best of some stretches: others may hold a dropout."""
    return max(amplitude(last(collector, 0.2), hz) for _ in range(ATTEMPTS))


def foreign(collector: Collector, hz: int) -> float:
    """The amplitude of a tone that should not be there: a dropout sounds a little like any."""
    return min(amplitude(last(collector), hz) for _ in range(ATTEMPTS))


def stream_of(connection: PulseConnection, process_id: int) -> Stream:
    def found() -> Stream | None:
        streams = connection.snapshot().sink_inputs
        return next((item for item in streams if item.process_id == process_id), None)

    return wait_for(found, "the player")


def ended(capture: AppCapture) -> EndReason:
    return wait_for(lambda: capture.ended, "the end of the capture", 1.0)


def test_samples_come_bit_for_bit(server, apps, connection):
    played = noise(4.0)

    def is_exact() -> bool:
        collector = Collector()
        with playing(server, "desktop", played) as process_id:
            capture = apps.open(stream_of(connection, process_id).index, RATE_HZ, 2, collector)
            wait_for(lambda: len(sounding(collector.frames())) > 2 * RATE_HZ, "sound")
            assert capture.close()
        heard = sounding(collector.frames())
        (starts,) = np.nonzero((played == heard[0]).all(axis=1))
        return any(np.array_equal(heard, played[at : at + len(heard)]) for at in starts)

    assert any(is_exact() for _ in range(ATTEMPTS))


def test_the_applications_volume_and_mute_count_the_sinks_do_not(server, apps):
    with tone(server, 440) as player:
        _, collector = captured(apps, player)
        index = str(player.index)

        def comes(level: float) -> None:
            wait_for(
                lambda: abs(amplitude(last(collector, 0.1), 440) - level) < 0.01 * LEVEL,
                f"level {level}",
            )

        comes(LEVEL)
        server.pactl("set-sink-input-volume", index, f"{10 ** (-12 / 20):.6f}")
        comes(LEVEL * 10 ** (-12 / 20))
        server.pactl("set-sink-input-mute", index, "1")
        comes(0.0)
        server.pactl("set-sink-input-mute", index, "0")
        server.pactl("set-sink-input-volume", index, "100%")
        server.pactl("set-sink-volume", "desktop", "30%")
        server.pactl("set-sink-mute", "desktop", "1")
        comes(LEVEL)


def test_the_server_converts_rate_and_channels_and_what_cannot_be_captured_is_said(server, apps):
    with tone(server, 440) as player:
        collector = Collector()
        capture = apps.open(player.index, 24_000, 1, collector)
        wait_for(lambda: len(collector.frames()) > 12_000, "frames")
        frames = collector.frames()[-6_000:]
        assert frames.shape[1] == 1
        assert frames.dtype == np.float32
        assert np.argmax(np.abs(np.fft.rfft(frames[:, 0]))) == pytest.approx(440 / 4, abs=1)
        assert capture.close()
    with pytest.raises(NotFoundError, match="no application plays a stream with the index 4711"):
        apps.open(4_711, RATE_HZ, 2, Collector())
    apps.close()
    with pytest.raises(LostError, match="is closed"):
        apps.open(0, RATE_HZ, 2, Collector())


def test_two_applications_come_apart_and_the_end_of_one_ends_its_capture_alone(server, apps):
    with tone(server, 440) as one, tone(server, 720) as other:
        capture, first = captured(apps, one)
        stays, second = captured(apps, other)
        for collector, own_hz, other_hz in ((first, 440, 720), (second, 720, 440)):
            assert steady(collector, own_hz) == pytest.approx(LEVEL, rel=0.01)
            assert foreign(collector, other_hz) < SILENT
        one.end()
        assert ended(capture) is EndReason.GONE
        assert capture.close()
        assert capture.ended is EndReason.GONE
        assert steady(second, 720) == pytest.approx(LEVEL, rel=0.01)
        assert (stays.ended, stays.errors) == (None, {})
        assert stays.frames >= stays.callbacks > 0
        assert stays.close()
        assert stays.ended is EndReason.CLOSED
        with pytest.raises(NotFoundError, match="ended just now"):
            apps.open(one.index, RATE_HZ, 2, first)


def test_a_moved_application_is_captured_on_or_its_capture_ends(server, apps):
    server.add_sink("speakers")
    with tone(server, 440) as player, tone(server, 720, "speakers"):
        capture, collector = captured(apps, player)
        last(collector)
        server.pactl("move-sink-input", str(player.index), "speakers")
        if server.kind == "pulse":
            assert ended(capture) is EndReason.TAKEN
            capture = apps.open(player.index, RATE_HZ, 2, collector)
        assert steady(collector, 440) == pytest.approx(LEVEL, rel=0.01)
        server.remove("desktop")
        assert steady(collector, 440) == pytest.approx(LEVEL, rel=0.01)
        # the gap of the move has something of all frequencies while it is among the last frames
        wait_for(lambda: foreign(collector, 720) < SILENT, "the player's sound alone")
        assert capture.ended is None


def test_a_server_that_dies_ends_all_captures(server, apps):
    with tone(server, 440) as one, tone(server, 720) as other:
        captures = [apps.open(item.index, RATE_HZ, 2, Collector()) for item in (one, other)]
        wait_for(lambda: all(capture.callbacks for capture in captures), "frames")
        server.kill()
        assert [ended(capture) for capture in captures] == [EndReason.LOST, EndReason.LOST]
        assert apps.lost is not None
        with pytest.raises(LostError, match="was lost"):
            apps.open(one.index, RATE_HZ, 2, Collector())
        assert all(capture.close() for capture in captures)
        with pytest.raises(LostError, match=r"no sound server answers at unix:.*; start"):
            AppCaptures()
    server.start()
    with tone(server, 440) as player:
        again = AppCaptures()
        _, collector = captured(again, player)
        assert steady(collector, 440) == pytest.approx(LEVEL, rel=0.01)
        assert again.close()


def test_a_server_that_hangs_counts_as_lost(server, apps):
    with tone(server, 440) as player:
        capture = apps.open(player.index, RATE_HZ, 2, Collector())
        wait_for(lambda: capture.callbacks, "frames")
        server.pause()
        asked_s = time.monotonic()
        with pytest.raises(LostError, match=r"does not answer|was lost"):
            apps.open(player.index, RATE_HZ, 2, Collector())
        assert time.monotonic() - asked_s < 2 * ANSWER_LIMIT_S + 0.5
        wait_for(lambda: capture.ended, "the end of the capture", ANSWER_LIMIT_S + 3.0)
        assert capture.ended is EndReason.LOST
        with pytest.raises(LostError):
            AppCaptures()
        server.resume()


@pytest.mark.parametrize("hangs", [False, True], ids=["pauses", "hangs"])
def test_an_application_that_pauses_or_hangs_is_not_lost_and_goes_on(server, apps, hangs):
    with tone(server, 440) as player:
        capture, collector = captured(apps, player)
        assert steady(collector, 440) == pytest.approx(LEVEL, rel=0.01)
        if hangs:
            player.process.send_signal(signal.SIGSTOP)
        else:
            player.tell("pause")

        def is_silent() -> bool:
            """For longer than it takes to ask whether the server is still there."""
            frames = capture.frames
            wait_seconds(1.5)
            return not collector.frames()[frames:].any()

        wait_for(is_silent, "silence")
        assert capture.ended is None
        if hangs:
            player.process.send_signal(signal.SIGCONT)
        else:
            player.tell("go on")
        assert steady(collector, 440) == pytest.approx(LEVEL, rel=0.01)


def test_an_application_that_pauses_already_is_captured_once_it_goes_on(server, apps, connection):
    with tone(server, 440) as player:
        player.tell("pause")
        wait_for(lambda: stream_of(connection, player.process.pid).corked, "the pause")
        capture, collector = captured(apps, player)
        given_up, unwanted = captured(apps, player)
        assert given_up.close()
        assert capture.ended is None
        assert not collector.frames().any()
        player.tell("go on")
        assert steady(collector, 440) == pytest.approx(LEVEL, rel=0.01)
        assert not unwanted.frames().any()
        wait_for(lambda: len(connection.snapshot().source_outputs) == 1, "the end of the other")


def test_a_microphone_is_never_captured(server, apps, connection):
    server.add_microphone("microphone")
    collector = Collector()
    captures: list[AppCapture] = []

    def capture(index: int) -> None:
        try:
            captures.append(apps.open(index, RATE_HZ, 2, collector))
        except (NotFoundError, LostError) as error:
            refused.append(str(error))

    refused: list[str] = []
    moments = random.Random(7)
    with tone(server, MICROPHONE_HZ, "microphone-room"):
        capture(4_711)
        with tone(server, 440) as player:
            capture(player.index)
            last(collector)
            own: Any = find_tagged(connection.snapshot().source_outputs, captures[-1].tag)
            with pytest.raises(ServerError):
                server.pactl("move-source-output", str(own.index), "microphone")
            last(collector)
        assert ended(captures[-1]) is EndReason.GONE
        for _ in range(6):  # it ends while its capture is being opened
            with tone(server, 440) as player:
                end = threading.Timer(moments.uniform(0.0, 0.05), player.end)
                end.start()
                capture(player.index)
                end.join()
        wait_for(lambda: all(item.ended for item in captures), "the end of the captures")
        with tone(server, 440) as player:
            capture(player.index)
            last(collector)
        wait_for(lambda: all(item.ended for item in captures), "the end of the captures")
    frames = collector.frames()
    pieces = np.array_split(frames, len(frames) // 4_800)
    heard = [amplitude(piece, MICROPHONE_HZ) for piece in pieces]
    assert max(heard) < 0.05 * LEVEL
    assert np.median(heard) < SILENT


def test_our_captures_are_known_and_not_captured_themselves(server, apps, connection):
    refuge = FallbackSink(connection)
    server.add_sink("virtual")
    server.pactl("load-module", "module-loopback", "source=virtual.monitor", "sink=desktop")
    with tone(server, 440, "virtual") as player, tone(server, 720, "haptic"):
        capture = apps.open(player.index, RATE_HZ, 2, Collector())
        own: Any = find_tagged(connection.snapshot().source_outputs, capture.tag)
        assert is_own_stream(own)
        assert (own.application, own.role) == (APPLICATION_NAME, ROLE)
        wait_for(lambda: len(connection.snapshot().sink_inputs) == 3, "the loopback")
        found = AppRules().select(connection.latest, "haptic")
        assert [stream.index for stream in found] == [player.index]
        assert capture.close()
    refuge.close()


def test_what_goes_wrong_in_on_frames_is_counted_and_stops_no_one(server, apps):
    def on_frames(frames: Float32Array, now_s: float) -> None:
        if not frames.flags.writeable:
            apps.open(player.index, RATE_HZ, 2, collector)

    with tone(server, 440) as player:
        collector = Collector()
        bad = apps.open(player.index, RATE_HZ, 2, on_frames)
        good = apps.open(player.index, RATE_HZ, 2, collector)
        last(collector)
        assert bad.errors.keys() == {InternalError.__name__}
        assert bad.errors["InternalError"] == pytest.approx(bad.callbacks, abs=2)
        assert good.errors == {}


def test_opening_and_closing_leaves_nothing_behind(server, connection):
    def held() -> tuple[int, int, int]:
        gc.collect()
        outputs = len(connection.snapshot().source_outputs)
        return outputs, threading.active_count(), open_files()

    def cycle() -> None:
        apps = AppCaptures()
        # Many more captures overload a small machine.
        captures = [apps.open(player.index, RATE_HZ, 2, Collector()) for _ in range(6)]
        wait_for(lambda: all(item.callbacks for item in captures), "frames")
        assert all(capture.close() for capture in captures[::2])
        wait_for(lambda: held()[0] == 3, "the end of half of them")
        assert apps.close()
        assert apps.close()
        assert all(capture.ended is EndReason.CLOSED for capture in captures)

    with tone(server, 440) as player:
        cycle()
        wait_for(lambda: held()[0] == 0, "the end of all streams")
        before = held()
        for _ in range(3):
            cycle()
        apps = AppCaptures()
        for _ in range(20):
            assert apps.open(player.index, RATE_HZ, 2, Collector()).close()
        assert apps.close()
        del apps
        wait_for(lambda: held() == before, f"return to {before}", 3.0)
