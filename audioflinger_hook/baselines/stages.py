"""Base class of the baselines, and filters that process a signal block by block."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfilt

from audioflinger_hook.transform import FloatArray, Frames
from audioflinger_hook.transform.downmix import MonoMix
from audioflinger_hook.transform.input_stage import channel_rows, fit_block, replace_unusable
from device.layouts import downmix

NYQUIST_MARGIN = 0.49  # a low-pass at or above this share of the sample rate is left out


class Baseline:
    """Converts sound block by block to one channel of vibration; both have full scale ±1.

    Subclasses implement `vibration`. Non-finite and extremely large samples count as 0.
    samplerate: of sound and vibration, in Hz. channels: of the sound.
    """

    latency_frames = 0  # latency of `process`, and length of the output of `finish`

    def __init__(self, samplerate: int, channels: int) -> None:
        self.samplerate = samplerate
        self._channels = channels
        self._mix = MonoMix(downmix(channels), samplerate)

    def process(self, frames: Frames) -> FloatArray:
        """Return the vibration, (frames, 1), of a block of sound, (frames, channels)."""
        usable, _ = replace_unusable(fit_block(frames, self._channels))
        return self.vibration(self._mix.process(channel_rows(usable)))[:, None]

    def finish(self) -> FloatArray:
        """Return the last `latency_frames` frames of the vibration, (latency_frames, 1)."""
        return self.vibration(np.zeros(self.latency_frames))[:, None]

    def vibration(self, sound: FloatArray) -> FloatArray:
        """Return the vibration, (frames,), of a block of mono sound, (frames,)."""
        raise NotImplementedError


class Filter:
    """A filter of second-order sections that keeps its state from block to block."""

    def __init__(self, sos: FloatArray) -> None:
        self._sos = sos
        self._state = np.zeros((len(sos), 2))

    def __call__(self, signal: FloatArray) -> FloatArray:
        """Return the next block of the signal, filtered."""
        if not signal.size:
            return signal
        filtered, self._state = sosfilt(self._sos, signal, zi=self._state)
        return np.asarray(filtered)


def high_pass(corner_hz: float, samplerate: int) -> Filter:
    """Return a second-order Butterworth high-pass."""
    return Filter(butter(2, corner_hz, "highpass", fs=samplerate, output="sos"))


def low_pass(corner_hz: float, samplerate: int) -> Filter:
    """Return a second-order Butterworth low-pass.

    If `corner_hz` is 0.49 of the sample rate or more, the filter changes nothing.
    """
    if corner_hz >= NYQUIST_MARGIN * samplerate:
        return Filter(np.array([[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]]))
    return Filter(butter(2, corner_hz, "lowpass", fs=samplerate, output="sos"))
