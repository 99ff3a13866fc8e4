"""What baselines share: sound made safe and mono, and filters that go on."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfilt

from audioflinger_hook.transform import FloatArray, Frames
from audioflinger_hook.transform.downmix import MonoMix
from audioflinger_hook.transform.input_stage import channel_rows, fit_block, replace_unusable
from device.layouts import downmix

NYQUIST_MARGIN = 0.49
"""A low-pass at or above this share of the samplerate is left out."""


class Baseline:
    """One stream of sound turned into one channel of vibration; full scale +-1 on both sides.

    Subclasses give `vibration`. Unusable samples count as 0, as in the transform.
    """

    latency_frames = 0
    """Delay of what `process` returns, and length of what `finish` returns."""

    def __init__(self, samplerate: int, channels: int) -> None:
        self.samplerate = samplerate
        self._channels = channels
        self._mix = MonoMix(downmix(channels), samplerate)

    def process(self, frames: Frames) -> FloatArray:
        """Return (frames, 1) of vibration for (frames, channels) of sound."""
        usable, _ = replace_unusable(fit_block(frames, self._channels))
        return self.vibration(self._mix.process(channel_rows(usable)))[:, None]

    def finish(self) -> FloatArray:
        """Return the vibration that is still delayed, (frames, 1)."""
        return self.vibration(np.zeros(self.latency_frames))[:, None]

    def vibration(self, sound: FloatArray) -> FloatArray:
        """Return as many frames of vibration as of mono sound."""
        raise NotImplementedError


class Filter:
    """Second-order sections with their state, continued from block to block."""

    def __init__(self, sos: FloatArray) -> None:
        self._sos = sos
        self._state = np.zeros((len(sos), 2))

    def __call__(self, signal: FloatArray) -> FloatArray:
        """Return the filtered block."""
        if not signal.size:
            return signal
        filtered, self._state = sosfilt(self._sos, signal, zi=self._state)
        return np.asarray(filtered)


def high_pass(corner_hz: float, samplerate: int) -> Filter:
    """Return a second-order Butterworth high-pass."""
    return Filter(butter(2, corner_hz, "highpass", fs=samplerate, output="sos"))


def low_pass(corner_hz: float, samplerate: int) -> Filter:
    """Return a second-order Butterworth low-pass, or none near half the samplerate."""
    if corner_hz >= NYQUIST_MARGIN * samplerate:
        return Filter(np.array([[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]]))
    return Filter(butter(2, corner_hz, "lowpass", fs=samplerate, output="sos"))
