"""`cushion test-tone`: a short vibration on one device, to find the right output."""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing

import numpy as np

from device.address import parse_device
from device.drive.channel_positions import sink_channel_map
from device.errors import LostError, UsageError
from device.server import FallbackSink, PulseConnection, StreamGuard
from device.server.guard import Hold
from device.stream import PcmConfig, PlaybackStream, filter_stderr
from device.stream.pcms import ServerDevice
from device.units import Float32Array

FADE_S = 0.1
LIMIT_HZ = (20.0, 220.0)


class Tone:
    """A sine with a soft start and end on some channels; `ended` is set once it is over."""

    def __init__(
        self, hz: float, level: float, duration_s: float, samplerate: int, channels: Sequence[int]
    ) -> None:
        time_s = np.arange(round(duration_s * samplerate)) / samplerate
        fade = np.clip(np.minimum(time_s, duration_s - time_s) / FADE_S, 0.0, 1.0)
        self._wave = (level * fade * np.sin(2.0 * np.pi * hz * time_s)).astype(np.float32)
        self._channels = list(channels)
        self._position = 0
        self.ended = threading.Event()

    def fill(self, out: Float32Array, now_s: float) -> None:
        """Write the next frames, equal in all its channels. Called by the output's thread."""
        part = self._wave[self._position : self._position + len(out)]
        self._position += len(part)
        out[: len(part), self._channels] = part[:, None]
        if len(part) < len(out):
            self.ended.set()


def run(options: argparse.Namespace) -> int:
    """Play the tone on this device and on no other."""
    low, high = LIMIT_HZ
    if not low <= options.hz <= high:
        raise UsageError(f"hz={options.hz:.12g} is out of range; allowed: {low:g} to {high:g} Hz")
    if not 0.0 < options.level <= 1.0:
        raise UsageError(f"level={options.level:.12g} is out of range; allowed: above 0, up to 1")
    if not FADE_S * 2 < options.seconds <= 60.0:
        raise UsageError(f"seconds={options.seconds:.12g} is out of range; allowed: 0.2 to 60 s")
    device = parse_device(options.device)
    if device.kind not in ("sink", "usb"):
        raise UsageError(
            f"device {str(device)!r} cannot play a test tone; allowed: sink:NAME, usb:VID:PID"
        )
    filter_stderr()
    with ExitStack() as stack:
        pcms = stack.enter_context(closing(PcmConfig("cushion_output")))
        connection = stack.enter_context(closing(PulseConnection()))
        sink = device.sink(connection.latest)
        stack.callback(FallbackSink(connection).close)
        pcm = pcms.pcms["cushion_output"]
        pcm.target = ServerDevice(sink.name)
        sources = sink_channel_map(sink, ()).sources
        channels = [channel for channel, source in enumerate(sources) if source is not None]
        tone = Tone(options.hz, options.level, options.seconds, sink.samplerate, channels)
        stream = PlaybackStream(pcm, sink.samplerate, sink.channels, tone.fill)
        stack.callback(stream.close)
        guard = StreamGuard(connection, stream, sink.name)
        stack.callback(guard.release)
        print(f"{sink.name} ({sink.description}): {options.hz:g} Hz", flush=True)
        _wait(tone, stream, guard)
    return 0


def _wait(tone: Tone, stream: PlaybackStream, guard: StreamGuard) -> None:
    """Wait for the tone's end, or raise if the stream is lost, even if PulseAudio moves it."""
    while not tone.ended.wait(0.1):
        if guard.hold is Hold.NO_DEVICE or stream.is_lost(time.monotonic()):
            raise LostError("the device was lost while the tone played; plug it in again")
