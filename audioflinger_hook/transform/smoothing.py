"""From the low rate to the stream's: a low-pass that stops what is audible, then interpolation."""

from __future__ import annotations

import numpy as np
from scipy.signal import ellip, freqz, lfilter

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.grid import LiveGrid
from audioflinger_hook.transform.windows import strided_windows

ORDER = 6
RIPPLE_DB = 0.5
STOP_DB = 40.0
EDGE_MARGIN = 1.01
"""The pass band ends this little above the top vibration frequency."""

TAPS = 4
"""Interpolation by four samples: what it adds to any partial up to 220 Hz is under -83 dB, for
0.7 ms of delay."""

FITTED_AT = 200
"""Frequencies at which the kernel is fitted."""

TABLE_STEP_HZ = 0.25


class Smoother:
    """Vibration at the low rate made smooth and brought to the stream's samplerate.

    Births and deaths of partials spread energy over the band where a shaker is heard; an
    elliptic low-pass just above the top vibration frequency takes it away with the least delay.
    Its ripple in the band is undone by each partial's own amplitude (`compensation`). Held by
    one thread at a time.
    """

    def __init__(self, grid: LiveGrid, top_hz: float) -> None:
        self._grid = grid
        self._b, self._a = ellip(
            ORDER, RIPPLE_DB, STOP_DB, EDGE_MARGIN * top_hz, fs=grid.low_rate_hz
        )
        self._table_hz = np.arange(0.0, EDGE_MARGIN * top_hz, TABLE_STEP_HZ)
        _, response = freqz(self._b, self._a, self._table_hz, fs=grid.low_rate_hz)
        self._table_gain = 1.0 / np.abs(response)
        self._phases = self._interpolation_phases(grid, EDGE_MARGIN * top_hz)
        self.reset()

    @staticmethod
    def _interpolation_phases(grid: LiveGrid, top_hz: float) -> FloatArray:
        """Return the kernel as (taps, decimation): each column yields one of the new frames.

        Nearest to a delay, by least squares, at all frequencies that are ever played: a cubic is
        better at the lowest ones, where it leaves nothing at all, and 13 dB worse at the top.
        """
        if grid.decimation == 1:
            return np.ones((1, 1))
        # Between the two samples in the middle.
        between = (np.arange(grid.decimation) + 0.5) / grid.decimation
        turn = 2.0 * np.pi * np.linspace(0.0, top_hz, FITTED_AT)[:, None] / grid.low_rate_hz
        taps = turn * (np.arange(TAPS) - (TAPS // 2 - 1))
        wanted = turn * between
        # Cosines and sines of both: a fit in real numbers.
        phases, *_ = np.linalg.lstsq(
            np.concatenate((np.cos(taps), np.sin(taps))),
            np.concatenate((np.cos(wanted), np.sin(wanted))),
        )
        return np.asarray(phases)

    def reset(self) -> None:
        """Return to rest."""
        self._state = np.zeros(ORDER)
        self._tail = np.zeros(len(self._phases) - 1)

    def delay_s(self, hz: float) -> float:
        """Return how late a steady partial's envelope leaves, in seconds."""
        step_hz = 0.01
        _, response = freqz(
            self._b, self._a, [hz - step_hz, hz + step_hz], fs=self._grid.low_rate_hz
        )
        turn = np.angle(response[0] / response[1])
        low_pass_s = turn / (2.0 * np.pi * 2.0 * step_hz)
        kernel_s = (self._phases.size - 1) / 2 / self._grid.samplerate
        return float(low_pass_s + kernel_s)

    def compensation(self, hz: FloatArray) -> FloatArray:
        """Return the amplitude factors that undo the low-pass's ripple at vibration frequencies."""
        factors: FloatArray = np.interp(hz, self._table_hz, self._table_gain)
        return factors

    def render(self, low_rate: FloatArray) -> FloatArray:
        """Return (frames,) at the stream's samplerate from (hops, steps) at the low rate.

        Each hop is one matrix product of fixed shape: larger ones may round otherwise.
        """
        hops, steps = low_rate.shape
        smooth, self._state = lfilter(self._b, self._a, low_rate.reshape(-1), zi=self._state)
        taps = len(self._phases)
        joined = np.concatenate((self._tail, smooth))
        self._tail = joined[joined.size - (taps - 1) :]
        windows = strided_windows(joined, taps, 1).reshape(hops, steps, taps)
        frames: FloatArray = windows @ self._phases
        return frames.reshape(-1)
