"""Samples go through the server unchanged, to where they belong, and streams survive its death."""

import ctypes
import gc
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from device.errors import LostError, UsageError
from device.layouts import layout, order_from_alsa
from device.stream import portaudio
from device.stream.pcms import PcmConfig, ServerDevice
from device.stream.streams import LOST_AFTER_S, CaptureStream, PlaybackStream
from device.units import Float32Array
from tests.servers import listening
from tests.servers.witness import Verdict
from tests.support.commands import open_files
from tests.support.costs import resident_bytes
from tools.sound_server_files import wireplumber_generation

POSITIONS = {
    "FL": "front-left",
    "FR": "front-right",
    "FC": "front-center",
    "LFE": "lfe",
    "BL": "rear-left",
    "BR": "rear-right",
    "SL": "side-left",
    "SR": "side-right",
}
"""The servers' names of positions."""


def output(pcms: PcmConfig, sink: str = "haptic") -> PlaybackStream:
    stream = listening.open_output(pcms, sink)
    stream.audible = True
    return stream


@pytest.mark.parametrize("channels", [5, 6, 8])
def test_surround_arrives_in_the_order_of_the_mixers_layout(server, pcms, channels):
    channel_map = ",".join(POSITIONS[name] for name in layout(channels))
    server.add_sink("surround", channel_map=channel_map)
    collector = listening.Collector()
    pcms.pcms["cushion_tap"].target = ServerDevice("surround.monitor")
    order = order_from_alsa(channels)
    stream = CaptureStream(
        pcms.pcms["cushion_tap"], listening.RATE_HZ, channels, collector, order=order
    )
    levels = np.arange(1, channels + 1, dtype=np.float32) / 16
    command = [
        *("pacat", "--playback", "--raw", "--format=float32le", f"--rate={listening.RATE_HZ}"),
        *(f"--channels={channels}", "--device=surround", f"--channel-map={channel_map}"),
    ]
    with subprocess.Popen(command, stdin=subprocess.PIPE, env=server.environment) as player:
        player.communicate(np.tile(levels, (listening.RATE_HZ, 1)).tobytes())
    listening.wait_for(
        lambda: len(listening.sounding(collector.frames())) > listening.RATE_HZ // 4, "sound"
    )
    stream.close()
    heard = listening.sounding(collector.frames())
    np.testing.assert_allclose(np.median(heard, axis=0), levels, atol=1e-3)


def test_a_stream_is_silent_until_it_may_sound_and_reaches_its_sink_alone(server, pcms, tmp_path):
    with (
        listening.recording(server, "haptic.monitor", tmp_path / "haptic") as felt,
        listening.recording(server, "desktop.monitor", tmp_path / "desktop") as heard,
    ):
        stream = listening.open_output(pcms)
        listening.wait_for(lambda: stream.callbacks > 100, "callbacks")
        assert not felt().any()
        assert stream.silenced == pytest.approx(stream.callbacks, abs=1)
        stream.audible = True
        listening.wait_for(lambda: np.count_nonzero(felt()) > listening.RATE_HZ, "vibration")
        assert stream.close()
        assert set(np.unique(felt())) <= {np.float32(0.0), listening.LEVEL}
        assert len(heard()) > listening.RATE_HZ // 4
        assert not heard().any()


def test_what_goes_wrong_in_a_callback_is_counted_and_becomes_silence(server, pcms, tmp_path):
    def fill(out: Float32Array, now_s: float) -> None:
        stream_blocks["dirty"] += bool(out.any())
        out[:] = 0.5
        if stream_blocks["n"] % 3 == 0:
            out[3, 1] = np.nan
        stream_blocks["n"] += 1
        if stream_blocks["n"] % 3 == 0:
            raise KeyError("x")

    def on_frames(frames: Float32Array, now_s: float) -> None:
        raise RuntimeError("no")

    stream_blocks = {"n": 0, "dirty": 0}
    pcms.pcms["cushion_output"].target = ServerDevice("haptic")
    pcms.pcms["cushion_tap"].target = ServerDevice("desktop.monitor")
    with listening.recording(server, "haptic.monitor", tmp_path / "haptic") as felt:
        stream = PlaybackStream(pcms.pcms["cushion_output"], listening.RATE_HZ, 2, fill)
        capture = CaptureStream(pcms.pcms["cushion_tap"], listening.RATE_HZ, 2, on_frames)
        stream.audible = True
        listening.wait_for(lambda: stream.callbacks > 200 and capture.callbacks > 100, "callbacks")
        assert stream.is_active()
        assert capture.is_active()
        assert stream.close()
        assert capture.close()
        assert np.isfinite(felt()).all()
        assert felt().any()
    assert not stream_blocks["dirty"]  # what it writes to is all 0, whatever the last one left
    assert stream.errors["KeyError"] == pytest.approx(stream.callbacks / 3, abs=5)
    assert stream.errors["FloatingPointError"] == pytest.approx(stream.callbacks / 3, abs=5)
    # the callbacks of a stream that is being closed do nothing
    assert capture.errors == {"RuntimeError": pytest.approx(capture.callbacks, abs=5)}


def test_a_server_that_hangs_costs_neither_the_caller_nor_the_process(server, pcms, monkeypatch):
    monkeypatch.setattr(portaudio, "OPEN_LIMIT_S", 0.3)
    monkeypatch.setattr(portaudio, "CLOSE_LIMIT_S", 0.3)
    stream = output(pcms)
    listening.wait_for(lambda: stream.callbacks > 20, "callbacks")
    server.pause()
    listening.wait_for(stream.is_lost, "loss", LOST_AFTER_S + 1.0)
    stream.close()
    with pytest.raises(LostError, match=r"not answered|not come back|does not answer"):
        output(pcms)
    server.resume()
    listening.wait_for(
        lambda: len(portaudio.open_tags) == listening.count_stuck(), "end of the streams"
    )
    stream = output(pcms)
    listening.wait_for(lambda: stream.callbacks > 20, "callbacks")
    assert stream.close()


def test_a_sink_that_has_played_2_s_ahead_is_waited_for(server, pcms):
    if server.kind == "pipewire":
        pytest.skip("PipeWire plays nothing ahead")
    server.pactl("load-module", "module-null-sink", "sink_name=ahead", "rate=48000", "channels=2")
    listening.wait_for(lambda: "ahead" in server.names("sinks"), "the sink")
    # on a busy machine the first callbacks may come so late that the stream counts as begun
    verdict, shown = Verdict("a stream that waits", needed=1), False
    while not shown:
        lost, waited_s = [], []
        for open_stream in (
            lambda: output(pcms, "ahead"),
            lambda: listening.open_tap(pcms, listening.Collector(), "ahead.monitor"),
        ):
            stream: PlaybackStream | CaptureStream = open_stream()
            longest_s = 0.0
            while (now_s := time.monotonic()) < stream.opened_s + 3.0:
                lost.append(stream.is_lost(now_s))
                longest_s = max(longest_s, now_s - stream.last_callback_s)
                threading.Event().wait(0.01)
            assert stream.close()
            waited_s.append(longest_s)
        shown = verdict.add(waited_s, good=not any(lost), witness_torn=False)
    assert min(waited_s) > LOST_AFTER_S  # there was something to wait for


def test_to_no_such_sink_nothing_plays_elsewhere(server, pcms, tmp_path):
    if server.kind == "pipewire" and wireplumber_generation() == 5:
        pytest.skip("WirePlumber 0.5 may play it elsewhere; then StreamGuard silences it")
    with listening.recording(server, "desktop.monitor", tmp_path / "desktop") as heard:
        try:
            stream = output(pcms, "nowhere")
        except LostError:
            pass  # PulseAudio at once, PipeWire as often as not
        else:
            listening.wait_for(stream.is_lost, "end of the stream", 2.0)
            assert stream.close()
        before = len(heard())
        listening.wait_for(lambda: len(heard()) > before + listening.RATE_HZ // 4, "sound")
        assert not heard().any()


def test_a_sink_is_played_to_and_tapped_whatever_it_is_called(server, pcms):
    known = set(server.names("sinks"))
    name = r'sink_name="it\'s \"größer\" } \\ than $HOME"'  # PulseAudio makes another one of it
    server.pactl("load-module", "module-null-sink", name, "norewinds=1", "format=float32le")
    (sink,) = listening.wait_for(lambda: set(server.names("sinks")) - known, "the sink")
    collector = listening.Collector()
    heard = listening.open_tap(pcms, collector, f"{sink}.monitor")
    played = output(pcms, sink)
    listening.wait_for(lambda: collector.frames().any(), "sound")
    assert played.close()
    assert heard.close()


def test_opening_and_closing_leaves_nothing_behind(server, pcms):
    def cycle() -> None:
        capture, playback = listening.open_tap(pcms, listening.Collector()), output(pcms)
        listening.wait_for(lambda: capture.callbacks > 2 and playback.callbacks > 2, "callbacks")
        assert capture.close()
        assert playback.close()

    def held() -> tuple[int, int, int]:
        gc.collect()
        tasks = len(list(Path("/proc/self/task").iterdir()))
        return threading.active_count(), tasks, open_files()

    def grown() -> int | None:
        """Memory after 20 cycles; None if one of them had to leave a stream behind."""
        before, before_bytes, abandoned = held(), resident_bytes(), listening.count_stuck()
        for _ in range(20):
            cycle()
        if listening.count_stuck() != abandoned:
            return None
        listening.wait_for(lambda: held() == before, f"return to {before}", 3.0)
        return resident_bytes() - before_bytes

    for _ in range(5):
        cycle()
    results = (grown() for _ in range(listening.ATTEMPTS))
    assert next(result for result in results if result is not None) < 2_000_000


def thread_states() -> int:
    """How many threads Python holds something for, the ones of callbacks included."""
    python = ctypes.pythonapi
    for function in (python.PyInterpreterState_Get, python.PyInterpreterState_ThreadHead):
        function.restype = ctypes.c_void_p
    python.PyInterpreterState_ThreadHead.argtypes = [ctypes.c_void_p]
    python.PyThreadState_Next.argtypes = [ctypes.c_void_p]
    python.PyThreadState_Next.restype = ctypes.c_void_p
    state, count = python.PyInterpreterState_ThreadHead(python.PyInterpreterState_Get()), 0
    while state:
        state, count = python.PyThreadState_Next(state), count + 1
    return count


def test_python_meets_a_stream_s_thread_once_and_forgets_it_at_the_end(server, pcms):
    python = ctypes.pythonapi
    python.PyThreadState_Get.restype = ctypes.c_void_p
    met: set[int] = set()

    def note(frames: Float32Array, now_s: float) -> None:
        met.add(python.PyThreadState_Get())

    def all_forgotten() -> bool:
        before = thread_states()
        pcms.pcms["cushion_tap"].target = ServerDevice("desktop.monitor")
        met.clear()
        stream = CaptureStream(pcms.pcms["cushion_tap"], listening.RATE_HZ, 2, note)
        listening.wait_for(lambda: stream.callbacks > 100, "callbacks")
        assert (len(met), thread_states()) == (1, before + 1)
        assert stream.close()
        return thread_states() == before

    # A callback that a busy machine delays beyond the time allowed leaves one behind.
    assert any(all_forgotten() for _ in range(listening.ATTEMPTS))


def test_what_cannot_be_opened_is_refused(server, pcms):
    with pytest.raises(UsageError, match="samplerate=12"):
        CaptureStream(pcms.pcms["cushion_tap"], 12, 2, listening.Collector())
    with pytest.raises(UsageError, match="channels=0"):
        PlaybackStream(pcms.pcms["cushion_tap"], listening.RATE_HZ, 0, listening.steady)
