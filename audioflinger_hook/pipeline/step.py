"""Client -> mixer -> effect -> outputs; each step is one cycle."""

from __future__ import annotations

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
    """The sound as mixed and the vibration as sent in one step, float32; either may be empty."""

    audio: NDArray[np.float32]
    vibration: NDArray[np.float32]


class HapticSink:
    """Takes the haptic channels out of a mix and sends them to the outputs, after a final clip.

    Samples that are not a number are sent as 0. clip: whether samples are limited to ±1, as for
    every device. Use from the thread that steps the mixer.
    """

    def __init__(self, *outputs: VibrationOutput, clip: bool = True) -> None:
        self._outputs = outputs
        self._limit = 1.0 if clip else np.inf
        self.sent = np.zeros((0, 0), np.float32)  # last; they change with the next buffer

    def write(self, buffer: MixBuffer) -> None:
        """Send the vibration of one cycle."""
        self.send(buffer.haptic)

    def send(self, vibration: NDArray[np.float32]) -> None:
        """Send frames that are in no buffer, such as the effect's last vibration at the end."""
        if self.sent.shape != vibration.shape:
            self.sent = np.empty(vibration.shape, np.float32)
        self.sent[...] = vibration
        if not peak(vibration) <= self._limit:  # also true for NaN
            np.clip(vibration, -self._limit, self._limit, out=self.sent)
            self.sent[np.isnan(self.sent)] = 0.0
        for output in self._outputs:
            output.write(self.sent)

    def standby(self) -> None:
        """Forget the last buffer."""
        self.sent[...] = 0.0


class RealTimePace:
    """Due times of frames played in real time from `start_s` of the caller's clock on."""

    def __init__(self, samplerate: int, start_s: float) -> None:
        self._samplerate = samplerate
        self._start_s = start_s

    def wait_s(self, frames: int, now_s: float) -> float:
        """Return the seconds until `frames` will have been played; 0 if they have been."""
        return max(0.0, self._start_s + frames / self._samplerate - now_s)


class Pipeline:
    """Moves sound from a client through mixer and effect to every output, from one thread."""

    def __init__(
        self, client: Client, framework: Framework, outputs: Sequence[VibrationOutput]
    ) -> None:
        self._client = client
        self._framework = framework
        self._outputs = tuple(outputs)
        self._sink = HapticSink(*outputs, clip=framework.settings.form != "reference")
        self._ended = False
        framework.mixer.sinks = (self._sink,)
        client.connect(framework.mixer)

    def step(self, now_s: float = 0.0) -> Step | None:
        """Do one cycle at `now_s` of any clock; return its sound and vibration, None at the end."""
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
        """Close the client and finish every output, the first one last, in case another fails."""
        self._client.close()
        for output in reversed(self._outputs):
            output.close()

    def abort(self) -> None:
        """Close the client and discard the outputs."""
        self._client.close()
        for output in self._outputs:
            output.abort()
