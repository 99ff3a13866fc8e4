"""What the audio threads run: captured frames through the chain into the delay line, and out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.chain import Chain
from audioflinger_hook.clients import TapClient
from audioflinger_hook.framework import Framework
from audioflinger_hook.service.buffer_times import BufferClock
from audioflinger_hook.service.levels import LevelMeter
from audioflinger_hook.settings import Settings
from audioflinger_hook.taps import PushTap
from device.clock import DelayLine
from device.units import Float32Array, FloatArray

IDLE_AFTER_S = 5.0
"""After silence of this length silent buffers are not treated any more: they give silence."""

FADED = 1e-6
"""Vibration below this, of full scale, is none: -120 dB."""


@dataclass(frozen=True)
class Clocks:
    """Where time comes from, in seconds: now_s goes on, used_s is the calling thread's CPU time."""

    now_s: Callable[[], float]
    used_s: Callable[[], float]


class Engine:
    """One stream of sound on its way to one device.

    samplerate, channels: of the tap; output_samplerate: of the device, Hz; offset_s: what the
    user adds to the delay; clocks: what time it is, and what the thread has used. `on_frames` is
    called by the capture's thread, `fill` by the output's; neither waits for the other. Any thread
    may read the rest.

    frames, last_sound_s: how many frames came, and when one of them was not silence. skipped:
    how many of them were silence that was not treated, after IDLE_AFTER_S of it and once the
    vibration had faded, too: silence passes by the chain into the delay line, which goes on, and
    the first buffer of sound finds the chain as silence leaves it.

    Raises
    ------
    UsageError
        The settings cannot be used with this stream.
    """

    def __init__(
        self,
        samplerate: int,
        channels: int,
        output_samplerate: int,
        settings: Settings | None = None,
        *,
        clocks: Clocks,
        offset_s: float = 0.0,
        now_s: float = 0.0,
    ) -> None:
        self._clocks = clocks
        self.samplerate = samplerate
        self.channels = channels
        self.framework = Framework(samplerate, channels, settings, clock=clocks.now_s)
        self.delay_line = DelayLine(
            self.framework.haptic_channels, samplerate, output_samplerate, offset_s=offset_s
        )
        self.sound = LevelMeter(samplerate)
        self.vibration = LevelMeter(samplerate)
        self.buffer_times = BufferClock()
        self.frames = 0
        self.skipped = 0
        self._faded = False
        self.last_sound_s = now_s
        self._tap = PushTap(samplerate, channels)
        self._into_line = _IntoLine(self.delay_line)
        self._client = TapClient(self._tap)
        self._chain = Chain(self._client, self.framework, [self._into_line])
        self._scratch = np.zeros((0, self.framework.haptic_channels), np.float32)
        self._silence = self._scratch

    def on_frames(self, frames: Float32Array, now_s: float) -> None:
        """Take captured frames, (frames, channels) float32, and put out what they make one feel.

        now_s: when they came, in seconds of time.monotonic().
        """
        if not len(frames):
            return
        began_s = self._clocks.used_s()
        self._into_line.now_s = now_s
        if frames.any():
            self.last_sound_s = now_s
            self._treat(frames, now_s)
        elif self._faded and now_s - self.last_sound_s > IDLE_AFTER_S:
            self._skip(len(frames))
        else:
            self._treat(frames, now_s)
        self.sound.add(frames)
        self.frames += len(frames)
        self.buffer_times.add(self._clocks.used_s() - began_s, len(frames) / self.samplerate)

    def _treat(self, frames: Float32Array, now_s: float) -> None:
        self._tap.push(frames)
        while self._tap.waiting or self._client.pending_frames:
            step = self._chain.step(now_s)
            if step is not None:
                self.vibration.add(step.vibration)
                self._faded = bool(np.abs(step.vibration).max(initial=0.0) < FADED)

    def _skip(self, count: int) -> None:
        """Let silence through without treating it."""
        if len(self._silence) != count:
            self._silence = np.zeros((count, self.framework.haptic_channels), np.float32)
        self._into_line.write(self._silence)
        self.vibration.add(self._silence)
        self.skipped += count

    def fill(self, out: Float32Array, now_s: float) -> None:
        """Write what the device plays next into `out`, (frames, channels of the device).

        Haptic channels repeat where the device has more; where it has fewer, the last are left
        out.
        """
        voices = self._scratch.shape[1]
        if len(self._scratch) != len(out):
            self._scratch = np.zeros((len(out), voices), np.float32)
        self.delay_line.read(self._scratch, now_s)
        for channel in range(out.shape[1]):
            out[:, channel] = self._scratch[:, channel % voices]


class _IntoLine:
    """The delay line as an output of the chain; now_s: when the frames being treated came."""

    def __init__(self, line: DelayLine) -> None:
        self._line = line
        self.now_s = 0.0
        self.samplerate = round(line.samplerate_in)
        self.channels = line.channels

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take one block."""
        self._line.write(vibration, self.now_s)

    def close(self) -> None:
        """Nothing is held."""

    def abort(self) -> None:
        """Drop what is waiting."""
        self._line.flush()
