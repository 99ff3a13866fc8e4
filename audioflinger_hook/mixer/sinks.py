"""Where a mixed buffer goes: the sound to an audio output, the haptic region to the device."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer.mix_buffer import MixBuffer
from audioflinger_hook.mixer.pcm import FLOAT_LIMIT, PcmFormat, encode
from device.blocks import peak
from device.output import VibrationOutput


class Sink(Protocol):
    """Takes every buffer that the mixer writes. The mixer's thread calls it."""

    def write(self, buffer: MixBuffer) -> None:
        """Take one buffer; it belongs to the mixer again when this returns."""
        ...

    def standby(self) -> None:
        """Nothing comes for a while: let go of what was kept. The next `write` ends it."""
        ...


class AudioSink:
    """Sends the audio region to an output of frames, clamped at ±2.0 as float sinks are.

    output: anything with `write`, for example a WAV file; its channels are those of the mix.
    """

    def __init__(self, output: VibrationOutput) -> None:
        self._output = output
        self._frames = np.zeros((0, 0), np.float32)

    def write(self, buffer: MixBuffer) -> None:
        """Send the sound."""
        self._frames = _like(self._frames, buffer.audio)
        _limited(buffer.audio, FLOAT_LIMIT, self._frames)
        self._output.write(self._frames)

    def standby(self) -> None:
        """Forget the last buffer."""
        self._frames[...] = 0.0


class PcmSink:
    """Sends the audio region as bytes of a sample format, to whatever takes bytes."""

    def __init__(self, send: Callable[[bytes], object], pcm_format: PcmFormat) -> None:
        self._send = send
        self._format = pcm_format

    def write(self, buffer: MixBuffer) -> None:
        """Send the sound, converted."""
        self._send(encode(buffer.audio, self._format))

    def standby(self) -> None:
        """Nothing was kept."""


class HapticSink:
    """Splits off the haptic region and sends it to the device; scale and clip come last.

    outputs: each takes the vibration, with as many channels as the mix has haptic ones; gain: of
    the whole device, from the next buffer on. What is sent lies within ±1, and what is not a
    number is sent as 0. clip=False is for files alone: they take what is beyond full scale.
    """

    def __init__(self, *outputs: VibrationOutput, gain: float = 1.0, clip: bool = True) -> None:
        self._outputs = outputs
        self._limit = 1.0 if clip else np.inf
        self.gain = gain
        self.sent = np.zeros((0, 0), np.float32)
        """The frames sent last; they change with the next buffer."""

    def write(self, buffer: MixBuffer) -> None:
        """Send the vibration."""
        self.send(buffer.haptic)

    def send(self, vibration: NDArray[np.float32]) -> None:
        """Send frames that are in no buffer: what was still owed at the end."""
        self.sent = _like(self.sent, vibration)
        np.multiply(vibration, np.float32(self.gain), out=self.sent)
        _limited(self.sent, self._limit, self.sent)
        for output in self._outputs:
            output.write(self.sent)

    def standby(self) -> None:
        """Forget the last buffer."""
        self.sent[...] = 0.0


def _like(frames: NDArray[np.float32], wanted: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return memory of the wanted shape, the same one as long as that does not change."""
    return frames if frames.shape == wanted.shape else np.zeros(wanted.shape, np.float32)


def _limited(frames: NDArray[np.float32], limit: float, limited: NDArray[np.float32]) -> None:
    """Fill `limited` with the frames cut at ±limit, NaN as 0; may be the same array."""
    if peak(frames) <= limit:  # as most buffers are; NaN is within no limit
        if limited is not frames:
            limited[...] = frames
        return
    np.clip(frames, -limit, limit, out=limited)
    absent = np.isnan(limited)
    if absent.any():
        limited[absent] = 0.0
