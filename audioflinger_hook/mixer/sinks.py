"""Where a mixed buffer goes: the sound to an audio output, the haptic region to the device."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer.mix_buffer import MixBuffer
from audioflinger_hook.mixer.pcm import FLOAT_LIMIT
from device.blocks import peak
from device.output import VibrationOutput


class Sink(Protocol):
    """Takes every buffer that the mixer writes. The mixer's thread calls it."""

    def write(self, buffer: MixBuffer) -> None:
        """Take one buffer; it belongs to the mixer again when this returns."""
        ...

    def standby(self) -> None:
        """Drop what was kept, since nothing follows for a while. The next `write` ends it."""
        ...


class AudioSink:
    """Sends the audio region to an output, clamped at ±2.0 as Android's float sinks are.

    Parameters
    ----------
    output : VibrationOutput
        Takes the frames, for example a WAV file; its channels are those of the mix.
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


class HapticSink:
    """Splits off the haptic region and sends it to the device; scale and clip come last.

    Samples that are not a number are sent as 0.

    Parameters
    ----------
    *outputs : VibrationOutput
        Each takes the vibration; its channels are the haptic channels of the mix.
    gain : float
        Factor for the whole device, from the next buffer on.
    clip : bool
        Whether samples are limited to ±1; False is for files only.
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
        """Send frames that are in no buffer, such as the effect's rest at the end."""
        self.sent = _like(self.sent, vibration)
        np.multiply(vibration, np.float32(self.gain), out=self.sent)
        _limited(self.sent, self._limit, self.sent)
        for output in self._outputs:
            output.write(self.sent)

    def standby(self) -> None:
        """Forget the last buffer."""
        self.sent[...] = 0.0


def _like(frames: NDArray[np.float32], wanted: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return memory of the wanted shape, the same array while the shape stays."""
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
