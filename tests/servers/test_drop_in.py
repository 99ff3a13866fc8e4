"""Drop-in mode: the server forwards the sound, as late as asked for, whatever becomes of us."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress

import numpy as np
import pytest

from device.errors import NotFoundError, UsageError
from device.server.drop_in import DropIn
from device.server.forwarding import SINK, loopbacks
from device.server.guard import Hold, StreamGuard
from device.server.identity import find_sink
from device.server.pulse import PulseConnection
from device.units import Float32Array
from tests.servers.daemons import ROOT, modules_of, program, tone
from tests.servers.listening import (
    RATE_HZ,
    arriving,
    insist_on_default,
    level_db,
    more,
    onsets,
    open_output,
    playing,
    recording,
    wait_for,
    wait_seconds,
)
from tools.sound_server import SoundServer
from tools.sound_server_files import keep_default_sink

DEFAULT = "@DEFAULT_SINK@"
ANOTHER_PROCESS = """
import sys
from device.server.drop_in import DropIn
from device.server.pulse import PulseConnection
drop_in = DropIn(PulseConnection(), delay_s=0.05, haptic_sink="haptic")
print(drop_in.target_name, flush=True)
sys.stdin.read()
"""


@contextmanager
def dropped_in(connection, target=None, delay_s=None):
    drop_in = DropIn(connection, target, delay_s, haptic_sink="haptic")
    try:
        wait_for_default(connection, SINK, 20.0)
        yield drop_in
    finally:
        drop_in.close()


def forwarded(connection: PulseConnection, drop_in: DropIn, target: str | None = None) -> bool:
    """Whether both streams of the loopback are on their devices, and that the target."""
    found = () if connection.lost else loopbacks(connection.latest)
    here = drop_in.target_name
    is_there = any(one.complete and one.route.target == here for one in found)
    return target in (None, here) and is_there


@contextmanager
def another_process() -> Iterator[subprocess.Popen[str]]:
    environ = os.environ | {"PYTHONPATH": str(ROOT)}
    command = (sys.executable, "-c", ANOTHER_PROCESS)
    with program(environ, *command, stdin=subprocess.PIPE) as process:
        assert process.stdout.readline().strip() == "desktop"
        yield process


@pytest.fixture(autouse=True)
def still_recordings(server):
    """PulseAudio moves what records the default source when the default sink is another one."""
    server.pactl("set-default-source", "haptic.monitor")


def places(connection: PulseConnection) -> dict[str, str]:
    """Where each playing program is, by its process id."""
    streams = connection.snapshot().sink_inputs
    return {str(stream.process_id): stream.device_name for stream in streams}


def wait_for_place(connection: PulseConnection, player: int, sink: str) -> None:
    wait_for(lambda: places(connection).get(str(player)) == sink, f"the player on {sink}")


def wait_for_default(connection: PulseConnection, sink: str, limit_s: float = 10.0) -> None:
    wait_for(lambda: connection.snapshot().default_sink == sink, f"default sink {sink}", limit_s)


def everything(server: SoundServer, connection: PulseConnection) -> object:
    """What is to be as it was: default sink, sinks, modules, programs and volumes."""
    return (
        server.pactl("get-default-sink"),
        server.names("sinks"),
        [line.split("\t")[1:] for line in modules_of(server)],
        places(connection),
        [server.pactl("get-sink-volume", name) for name in server.names("sinks")],
    )


def sounds(heard: Callable[[], Float32Array], seconds: float = 0.1) -> bool:
    """Whether the end of a recording is sound without a gap."""
    last = heard()[-int(seconds * RATE_HZ) :]
    return len(last) >= int(seconds * RATE_HZ) and bool(
        np.abs(last).reshape(-1, 96).max(axis=1).min() > 0.01
    )


def lateness_ms(server: SoundServer, played: Float32Array) -> float:
    """By how much later clicks come from the real sink than from the virtual one: the median."""
    with (
        arriving(server, f"{SINK}.monitor") as near,
        arriving(server, "desktop.monitor") as far,
        playing(server, SINK, played),
    ):
        wait_for(lambda: len(onsets(far.frames(), 0.2)) > 6, "clicks", 20.0)
        early = [near.at_s(frame) for frame in onsets(near.frames(), 0.2)]
        late = np.array([far.at_s(frame) for frame in onsets(far.frames(), 0.2)])
    return float(np.median([1e3 * (late - at_s)[late > at_s - 0.02].min() for at_s in early[:6]]))


def clicks(seconds: float) -> Float32Array:
    frames = np.zeros((int(seconds * RATE_HZ), 2), np.float32)
    for start in range(RATE_HZ // 4, len(frames) - RATE_HZ // 4, RATE_HZ // 2):
        frames[start : start + 48] = 0.6
    return frames


@pytest.mark.parametrize("delay_ms", [0, 75, 150])
def test_the_sound_is_as_late_as_asked_for(server, connection, delay_ms):
    wanted_ms = max(delay_ms, 20)
    with dropped_in(connection, delay_s=delay_ms / 1e3) as drop_in:
        measured = [lateness_ms(server, clicks(20.0))]
        # where a busy machine held PulseAudio up it finds back at 1 % of speed
        while abs(measured[-1] - wanted_ms) > 10.0 and len(measured) < 10:
            measured.append(lateness_ms(server, clicks(20.0)))
        assert abs(measured[-1] - wanted_ms) <= 10.0
        drop_in.delay_s = 0.1
        wait_for(lambda: delays(connection) == ["100"], "the other delay")
        with pytest.raises(UsageError, match="delay_s"):
            drop_in.delay_s = 0.6


def forwarders(connection: PulseConnection) -> list[tuple[int, str]]:
    """Index and delay in ms of each."""
    streams = [one for one in connection.snapshot().sink_inputs if one.module is not None]
    return [(one.index, one.properties["cushion.delay_ms"]) for one in streams]


def delays(connection: PulseConnection) -> list[str]:
    return [delay_ms for _, delay_ms in forwarders(connection)]


def test_another_delay_while_sound_plays_is_no_more_than_a_short_gap(server, connection, tmp_path):
    with (
        dropped_in(connection, delay_s=0.02) as drop_in,
        recording(server, "desktop.monitor", tmp_path / "far", stays=True) as far,
        playing(server, DEFAULT, np.full((60 * RATE_HZ, 2), 0.2, np.float32)),
    ):

        def silence_ms(delay_ms: int) -> float:
            wait_for(lambda: sounds(far, 0.3), "sound")
            before = len(far())
            drop_in.delay_s = delay_ms / 1e3
            wait_for(lambda: delays(connection) == [str(delay_ms)], "the other delay")
            more(far, 0.25)
            return np.count_nonzero(np.abs(far()[before:, 0]) < 0.01) / 48

        silences = [silence_ms(75 if trial % 2 == 0 else 20) for trial in range(6)]
        # loading anew would cost 75 ms and more; xruns come on top
        assert min(silences[::2]) < 50.0


@pytest.mark.calm
def test_after_a_kill_sound_goes_on_and_the_next_process_takes_over(server, connection, tmp_path):
    with ExitStack() as stack:
        stack.enter_context(playing(server, DEFAULT, tone(440.0, 60.0)))
        wait_for(lambda: list(places(connection).values()) == ["desktop"], "the player")
        before = everything(server, connection)
        desktop = recording(server, "desktop.monitor", tmp_path / "far", stays=True)
        far = stack.enter_context(desktop)
        with another_process() as process:
            wait_for(lambda: SINK in places(connection).values(), "the player in between")
            wait_for(lambda: sounds(far, 0.5), "sound")
            process.send_signal(signal.SIGKILL)
            process.wait(5.0)
            killed = len(far())
        wait_for(lambda: len(far()) > killed + RATE_HZ, "a second")
        assert SINK in places(connection).values()
        forwarder = forwarders(connection)
        with dropped_in(connection) as drop_in:
            assert (drop_in.target_name, drop_in.delay_s) == ("desktop", 0.05)
            assert forwarded(connection, drop_in)
            wait_for(lambda: sounds(far, 0.2), "sound")
            assert forwarders(connection) == forwarder  # the same one: no gap
            heard = far()[killed:, 0]
        blocks = np.abs(heard[: len(heard) // 96 * 96]).reshape(-1, 96)
        silent = np.count_nonzero(blocks.max(axis=1) < 0.01)
        assert silent * 96 < 0.1 * RATE_HZ  # xruns of a busy machine, no more
        assert everything(server, connection) == before


def test_closing_leaves_everything_as_it_was_again_and_again(server, connection, tmp_path):
    server.add_sink("speakers")
    server.pactl("set-sink-volume", "desktop", "40%")
    sound = tone(440.0, 60.0)
    with (
        playing(server, DEFAULT, sound) as follower,
        playing(server, "speakers", sound) as bound,
        playing(server, "haptic", sound) as apart,
    ):
        wait_for(lambda: len(places(connection)) == 3, "three players")
        before = everything(server, connection)
        between = {str(follower): SINK, str(bound): SINK, str(apart): "haptic"}
        between["None"] = "speakers"  # the loopback
        for _ in range(10):
            with dropped_in(connection, "speakers", 0.03) as drop_in:
                wait_for(lambda: places(connection) == between, "both players in between")
            drop_in.close()  # again, which does nothing
            wait_for(lambda: everything(server, connection) == before, "what was before", 2.0)
        server.choose_default("haptic")  # and streams follow the default sink as before
        after = {str(follower): "haptic", str(bound): "speakers", str(apart): "haptic"}
        wait_for(lambda: places(connection) == after, "the player on the other default sink")


def test_without_its_sink_the_sound_goes_elsewhere_until_that_is_back(server, connection, tmp_path):
    server.add_sink("speakers")
    with (
        dropped_in(connection) as drop_in,
        playing(server, DEFAULT, tone(440.0, 60.0)),
        recording(server, "haptic.monitor", tmp_path / "haptic", stays=True) as felt,
    ):
        with recording(server, "speakers.monitor", tmp_path / "other", stays=True) as other:
            assert not sounds(other)
            server.remove("desktop")
            wait_for(lambda: sounds(other), "sound from the other sink")
            assert drop_in.target_name == "speakers"
        server.add_sink("desktop")
        with recording(server, "desktop.monitor", tmp_path / "first", stays=True) as first:
            wait_for(lambda: sounds(first), "sound from the first sink")
        wait_for(lambda: forwarded(connection, drop_in, "desktop"), "the first sink")
        for name in ("desktop", "speakers"):
            server.remove(name)
        wait_for(lambda: "no sink is left" in drop_in.reason, "the reason")
        assert not forwarded(connection, drop_in)
        server.add_sink("speakers")
        wait_for(lambda: forwarded(connection, drop_in, "speakers"), "forwarding")
        wait_for(lambda: not drop_in.reason, "the end of the reason")
        assert not np.any(felt())  # never the haptic sink


def test_the_default_sink_that_a_user_chooses_becomes_the_target(server, connection, tmp_path):
    server.add_sink("speakers")
    with playing(server, DEFAULT, tone(440.0, 60.0)) as player:
        wait_for(lambda: places(connection), "the player")
        with (
            dropped_in(connection) as drop_in,
            recording(server, "speakers.monitor", tmp_path / "other", stays=True) as other,
        ):
            server.pactl("set-default-sink", "speakers")
            wait_for(lambda: drop_in.target_name == "speakers", "the choice")
            wait_for_default(connection, SINK)
            wait_for_place(connection, player, SINK)
            wait_for(lambda: sounds(other), "sound from the chosen sink")
            assert forwarded(connection, drop_in)
        assert connection.snapshot().default_sink == "speakers"
        wait_for(lambda: places(connection) == {str(player): "speakers"}, "the player", 2.0)


def test_a_default_sink_is_chosen_once_it_has_persisted(server, connection):
    """Once it was held up, WirePlumber makes the sinks of two requests the default in one go."""
    server.add_sink("speakers")
    with dropped_in(connection, "speakers") as drop_in:
        assert drop_in._default.stable_name == SINK  # no more the former one, of which a moment...
        wait_for(lambda: drop_in._default.settled, "the own default sink")
        server.pactl("set-default-sink", "desktop")  # ... is no choice, but this is one
        wait_for(lambda: drop_in.target_name == "desktop", "the choice")


def test_the_haptic_sink_is_no_target_and_our_own_stream_stays_on_it(server, connection, pcms):
    stream = open_output(pcms)
    guard = StreamGuard(connection, stream, "haptic")
    wait_for(lambda: guard.hold is Hold.FREE, "our stream")
    with dropped_in(connection) as drop_in, playing(server, DEFAULT, tone(440.0, 60.0)) as player:
        wait_for_place(connection, player, SINK)
        server.pactl("set-default-sink", "haptic")
        wait_for(lambda: "the vibration goes there" in drop_in.reason, "the refusal")
        wait_for_default(connection, SINK)
        wait_for_place(connection, player, SINK)
        assert drop_in.target_name == "desktop"
        wait_for(lambda: guard.hold is Hold.FREE, "our stream")  # PulseAudio had moved it
    wait_for_place(connection, os.getpid(), "haptic")
    stream.close()
    guard.release()


def test_what_cannot_be_forwarded_to_is_refused_and_leaves_nothing(server, connection):
    before = everything(server, connection)
    with pytest.raises(NotFoundError, match="no sink 'desktob'; did you mean 'desktop'"):
        DropIn(connection, "desktob")
    with pytest.raises(NotFoundError, match="'haptic': the vibration goes there"):
        DropIn(connection, "haptic", haptic_sink="haptic")
    with pytest.raises(UsageError, match=r"delay_s=0\.6 is out of range; choose 0 to 0\.5 s"):
        DropIn(connection, delay_s=0.6)
    insist_on_default(server, connection, "haptic")
    with pytest.raises(NotFoundError, match="'haptic': the vibration goes there"):
        DropIn(connection, haptic_sink="haptic")
    insist_on_default(server, connection, "desktop")
    assert everything(server, connection) == before
    server.add_sink(SINK)
    with pytest.raises(NotFoundError, match="is not ours"):
        DropIn(connection)


def test_sound_keeps_its_level_and_volume_is_that_of_the_virtual_sink(server, connection, tmp_path):
    server.pactl("set-sink-volume", "desktop", "80%")
    with (
        dropped_in(connection, delay_s=0.05) as drop_in,
        playing(server, DEFAULT, tone(1_000.0, 60.0)),
        recording(server, f"{SINK}.monitor", tmp_path / "near", stays=True) as near,
        recording(server, "desktop.monitor", tmp_path / "far", stays=True) as far,
    ):

        def levels() -> np.ndarray:
            return np.array([level_db(heard()[-RATE_HZ // 4 :]) for heard in (near, far)])

        assert (drop_in.target_name, drop_in.delay_s) == ("desktop", 0.05)
        loud = level_db(tone(1_000.0, 1.0)) + np.array([0.0, 60.0 * np.log10(0.8)])
        wait_for(lambda: np.abs(levels() - loud).max() < 0.2, "the full volume")
        wait_for(lambda: sounds(far) and sounds(near), "sound without gaps")
        server.pactl("set-sink-volume", DEFAULT, "50%")
        soft = loud + 60.0 * np.log10(0.5)
        wait_for(lambda: np.abs(levels() - soft).max() < 0.2, "half the volume")
        assert "80%" in server.pactl("get-sink-volume", "desktop")
    assert "80%" in server.pactl("get-sink-volume", "desktop")


def test_a_stream_that_somebody_moves_away_is_left_there(server, connection):
    server.add_sink("speakers")
    with dropped_in(connection), playing(server, DEFAULT, tone(440.0, 60.0)) as player:
        wait_for_place(connection, player, SINK)
        snapshot = connection.latest
        index = next(item.index for item in snapshot.sink_inputs if item.process_id == player)
        connection.move_sink_input(index, find_sink(snapshot, "desktop").index)
        wait_for_place(connection, player, "desktop")
        wait_seconds(1.0)
        assert places(connection)[str(player)] == "desktop"
        with playing(server, "desktop", tone(440.0, 60.0)) as new:
            wait_for_place(connection, new, SINK)


def test_a_program_that_wants_the_default_sink_for_itself_gets_it(server, connection):
    server.add_sink("speakers")
    with dropped_in(connection) as drop_in:

        def insists() -> bool:
            if connection.snapshot().default_sink == SINK:
                server.pactl("set-default-sink", "speakers")
            return "another program" in drop_in.reason

        # a connection to PipeWire that is not told of a default is found and renewed in 6 s
        wait_for(insists, "the reason", 20.0)
        wait_for_default(connection, "speakers")
        assert connection.snapshot().default_sink == "speakers"
        assert forwarded(connection, drop_in)
        server.pactl("set-default-sink", SINK)
        wait_for(lambda: drop_in.reason == "", "the end of the contest")


def test_a_virtual_sink_that_is_forwarded_to_brings_nothing_back(server, connection, tmp_path):
    module = server.pactl(
        "load-module", "module-remap-sink", "sink_name=virtual", "master=desktop", "channels=2"
    )
    insist_on_default(server, connection, "virtual")

    def outlet():
        streams = connection.snapshot().sink_inputs
        return next(item for item in streams if str(item.module) == module)

    with (
        dropped_in(connection) as drop_in,
        playing(server, DEFAULT, tone(440.0, 60.0)),
        recording(server, f"{SINK}.monitor", tmp_path / "near", stays=True) as near,
    ):
        wait_for(lambda: outlet().device_name == "desktop", "the virtual sink's sound")
        assert drop_in.target_name == "virtual", drop_in.reason
        with suppress(NotFoundError):  # PipeWire binds it to its master
            connection.move_sink_input(outlet().index, find_sink(connection.latest, SINK).index)
        wait_for(lambda: outlet().device_name == "desktop", "the virtual sink's sound")
        heard = more(near, 2.0)[-RATE_HZ // 2 :]
        assert abs(level_db(heard) - level_db(tone(440.0, 1.0))) < 0.2  # one sound, not many
        assert forwarded(connection, drop_in)
    server.choose_default("desktop")
    server.pactl("unload-module", module)


def test_a_server_started_anew_has_a_usable_default_sink(server, connection, monkeypatch):
    server.stop()
    keep_default_sink(server.kind, server.folder)
    server.start()
    connection = PulseConnection()
    drop_in = DropIn(connection, haptic_sink="haptic")
    wait_for_default(connection, SINK)
    wait_for(lambda: remembers(server), "the server's memory")
    server.kill()
    wait_for(lambda: connection.lost, "the loss")
    assert not forwarded(connection, drop_in)
    drop_in.close()
    connection.close()
    monkeypatch.setattr(server, "choose_default", lambda name: None)
    server.start()
    connection = PulseConnection()
    wait_for(lambda: connection.snapshot().default_sink, "a default sink")
    assert connection.latest.default_sink in ("desktop", "haptic")
    with dropped_in(connection, "desktop") as drop_in:
        assert forwarded(connection, drop_in)
    assert connection.snapshot().default_sink in ("desktop", "haptic")
    connection.close()


def remembers(server: SoundServer) -> bool:
    """Whether the server has written down that the default sink is ours."""
    with suppress(OSError):  # a file of its that is not finished
        files = [path for path in (server.folder / "state").rglob("*default*") if path.is_file()]
        return any(SINK in path.read_text(errors="replace") for path in files)
    return False
