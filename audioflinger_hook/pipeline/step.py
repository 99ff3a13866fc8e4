"""Moves sound from a client through mixer and effects to the outputs."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer.mix_buffer import MixBuffer
from audioflinger_hook.pipeline.framework import Framework
from audioflinger_hook.sources import Client
from device.blocks import peak
from device.output import VibrationOutput


class Step(NamedTuple):
    """Mixed sound and vibration of one cycle, (frames, channels), float32; both may be empty."""

    audio: NDArray[np.float32]
    vibration: NDArray[np.float32]


class HapticSink:
    """Sends the haptic channels of a mix to outputs. clip: whether to limit the samples to ±1."""

    def __init__(self, *outputs: VibrationOutput, clip: bool = True) -> None:
        self._outputs = outputs
        self._limit = 1.0 if clip else np.inf
        self.sent = np.zeros((0, 0), np.float32)  # the latest frames; `send` overwrites them

    def write(self, buffer: MixBuffer) -> None:
        """Send the vibration of one cycle."""
        self.send(buffer.haptic)

    def send(self, vibration: NDArray[np.float32]) -> None:
        """Send vibration, limited if `clip` is set. NaN becomes 0."""
        if self.sent.shape != vibration.shape:
            self.sent = np.empty(vibration.shape, np.float32)
        self.sent[...] = vibration
        if not peak(vibration) <= self._limit:  # this condition is also true for NaN
            np.clip(vibration, -self._limit, self._limit, out=self.sent)
            self.sent[np.isnan(self.sent)] = 0.0
        for output in self._outputs:
            output.write(self.sent)

    def standby(self) -> None:
        """Set the frames in `sent` to 0."""
        self.sent[...] = 0.0


class RealTimePace:
    """Computes how long to wait, for playback in real time. start_s: time of the start."""

    def __init__(self, samplerate: int, start_s: float) -> None:
        self._samplerate, self._start_s = samplerate, start_s

    def wait_s(self, frames: int, now_s: float) -> float:
        """Return the seconds until `frames` frames have been played; 0 if that time has passed."""
        return max(0.0, self._start_s + frames / self._samplerate - now_s)


class Pipeline:
    """Moves sound from a client through the framework to all outputs, on one thread."""

    def __init__(
        self, client: Client, framework: Framework, outputs: Sequence[VibrationOutput]
    ) -> None:
        self._client, self._framework, self._outputs = client, framework, tuple(outputs)
        self._sink = HapticSink(*outputs, clip=framework.settings.form != "reference")
        self._ended = False
        framework.mixer.sinks = (self._sink,)
        client.connect(framework.mixer)

    def step(self, now_s: float = 0.0) -> Step | None:
        """Run one cycle at time `now_s`; return sound and vibration, or None after the end."""
        if self._ended:
            return None
        frames, mixer = self._client.play(), self._framework.mixer
        audio = np.zeros((0, mixer.channels), np.float32)
        if frames is None:
            self._ended = True
            self._sink.send(self._framework.drain())
        elif frames == 0:
            return Step(audio, np.zeros((0, mixer.haptic_channels), np.float32))
        else:
            audio = mixer.cycle(now_s, frames).buffer.audio.copy()
        return Step(audio, self._sink.sent.copy())

    def close(self) -> None:
        """Close the client, then the outputs in reverse order."""
        self._client.close()
        for output in reversed(self._outputs):
            output.close()

    def abort(self) -> None:
        """Close the client and discard the outputs."""
        self._client.close()
        for output in self._outputs:
            output.abort()
