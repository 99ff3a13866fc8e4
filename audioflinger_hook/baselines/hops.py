"""Base class of methods that compute sines from spectra of the sound."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import rfft
from scipy.signal.windows import hann

from audioflinger_hook.baselines.stages import Baseline
from audioflinger_hook.transform import FloatArray

POINTS_AT_48_KHZ = 1_024


class SineBaseline(Baseline):
    """Sines whose frequencies and amplitudes follow the spectra of overlapping Hann windows.

    Windows have 1024 frames at 44.1 and 48 kHz. At other rates, the number of frames is the power
    of two that is nearest to 21 ms. During the hop after a window, frequencies and amplitudes
    change linearly to the values that `lead` returns. The latency is therefore one hop. Subclasses
    implement `lead`.

    voices: number of sines. overlap: number of hops in a window.
    """

    def __init__(self, samplerate: int, channels: int, voices: int, overlap: int) -> None:
        super().__init__(samplerate, channels)
        self.points = 2 ** max(6, round(np.log2(POINTS_AT_48_KHZ * samplerate / 48_000)))
        self.hop = self.points // overlap
        self.bins_hz = np.arange(self.points // 2 + 1) * (samplerate / self.points)
        window = hann(self.points, sym=False)
        self._window = window * (2.0 / window.sum())
        self.latency_frames = self.hop
        self._heard = np.zeros(self.points - self.hop)
        self._ready = np.zeros(self.hop)
        self._hz = np.zeros(voices)
        self._amplitude = np.zeros(voices)
        self._cycles = np.zeros(voices)

    def lead(self, amplitude: FloatArray, newest: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the frequency in Hz and the amplitude of each sine after each hop, (hops, voices).

        amplitude: magnitudes of the spectra, (hops, bins); 1 for a full-scale sine.
        newest: the last hop of each window, (hops, frames of a hop).
        """
        raise NotImplementedError

    def vibration(self, sound: FloatArray) -> FloatArray:
        """Return as many frames of vibration as of sound, delayed by one hop."""
        heard = np.concatenate((self._heard, sound))
        hops = (heard.size - self.points) // self.hop + 1 if heard.size >= self.points else 0
        if hops:
            windows = sliding_window_view(heard, self.points)[:: self.hop]
            amplitude = np.abs(rfft(windows * self._window, axis=1))
            hz, level = self.lead(amplitude, windows[:, -self.hop :])
            self._ready = np.concatenate((self._ready, self._sines(hz, level)))
            heard = heard[hops * self.hop :]
        self._heard = heard
        played, self._ready = self._ready[: sound.size], self._ready[sound.size :]
        return played

    def _sines(self, hz: FloatArray, amplitude: FloatArray) -> FloatArray:
        from_amplitude = np.vstack((self._amplitude, amplitude[:-1]))
        from_hz = np.where(from_amplitude == 0.0, hz, np.vstack((self._hz, hz[:-1])))
        share = (np.arange(self.hop) + 1.0)[:, None] / self.hop
        glide_hz = from_hz[:, None] + (hz - from_hz)[:, None] * share
        swell = from_amplitude[:, None] + (amplitude - from_amplitude)[:, None] * share
        steps = glide_hz.reshape(-1, hz.shape[1]) / self.samplerate
        cycles = self._cycles + np.cumsum(steps, axis=0)
        self._hz, self._amplitude, self._cycles = hz[-1], amplitude[-1], cycles[-1] % 1.0
        waves = swell.reshape(cycles.shape) * np.sin(2.0 * np.pi * cycles)
        total: FloatArray = waves.sum(axis=1)
        return total
