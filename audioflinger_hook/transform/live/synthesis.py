"""From the low rate to the stream's: a low-pass that stops what is audible, then interpolation.

The oscillator bank: glides of frequency and amplitude to samples at the low rate.

Full scale kept smoothly: partials are scaled down before they sound, the rest is rounded off.

The amplitudes of the next hop are known before it is played, and their sum bounds the wave. So
the limiter looks ahead for nothing, changes gain as slowly as any amplitude, and makes no
distortion. What little can still overshoot (the low-pass rings at a sudden start) meets a knee.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import ellip, freqz, lfilter

from audioflinger_hook.transform.arrays import FloatArray, strided_windows
from audioflinger_hook.transform.design import LiveGrid
from audioflinger_hook.transform.live.partials import Glides

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


ATTACK_HOPS = 0.35
"""Share of a hop in which amplitudes glide where their sum rises: an onset is felt 5 ms earlier
than with a whole one, and the low-pass still keeps what leaks above 250 Hz under -58 dB. Where
the sum falls they take the whole hop."""


STILL = 1e-9
"""A sum of amplitudes rises from here on: rounding must not choose between the two shapes."""


class OscillatorBank:
    """Samples of gliding partials; pure, holds only the shape of a glide.

    Glides follow half a cosine period, u = (1 - cos(pi t))/2: no kink at either end, so a birth
    or a death leaks least. Phase is the integral of frequency and therefore continuous.
    """

    delay_hops = 0.5 + (ATTACK_HOPS + 1.0) / 4.0
    """How late an amplitude follows its analysis: half a hop held, and half a glide on average."""

    def __init__(self, steps: int, hop_s: float, attack: float = ATTACK_HOPS) -> None:
        time = np.arange(1, steps + 1) / steps
        self._steps = steps
        self._glide = 0.5 - 0.5 * np.cos(np.pi * time)
        self._attack = 0.5 - 0.5 * np.cos(np.pi * np.minimum(1.0, time / attack))
        turns = 2.0 * np.pi * hop_s
        self._turn = turns * time
        self._turn_glide = turns * (0.5 * time - np.sin(np.pi * time) / (2.0 * np.pi))

    def render(self, glides: Glides) -> FloatArray:
        """Return (hops, steps) of the summed partials, full scale.

        Slots are added one after another, so a slot at amplitude 0 changes no byte and is left
        out where it is silent in the whole batch.
        """
        rise = glides.end_amplitude - glides.start_amplitude
        loudest = np.maximum(glides.start_amplitude, glides.end_amplitude).max(axis=0)
        slots = loudest.nonzero()[0]

        def of_slots(values: FloatArray) -> FloatArray:
            chosen: FloatArray = values.take(slots, axis=1).T[:, :, None]
            return chosen

        start_hz = of_slots(glides.start_hz)
        phase = start_hz * self._turn
        phase += (of_slots(glides.end_hz) - start_hz) * self._turn_glide
        phase += (2.0 * np.pi) * of_slots(glides.start_phase)
        partials = np.cos(phase, out=phase)
        # One shape for all slots of a hop: then their sum never exceeds both its ends, which is
        # what keeps the wave under full scale.
        rising = np.add.reduce(rise, axis=1) > STILL
        shape = np.where(rising[:, None], self._attack, self._glide)
        level = of_slots(rise) * shape
        level += of_slots(glides.start_amplitude)
        partials *= level
        total: FloatArray = np.add.reduce(partials, axis=0)
        return total


CEILING = 0.98
"""Largest sum of a hop's amplitudes; a full-scale tone keeps its level within 0.2 dB."""

KNEE = 0.985
"""Samples up to here pass as they are; above, they approach full scale and never reach it."""


def limited_amplitudes(amplitude: FloatArray) -> tuple[FloatArray, bool]:
    """Return one hop's amplitudes, scaled so that they sum to `CEILING` at most, and whether."""
    total = float(amplitude.sum())
    if total <= CEILING:
        return amplitude, False
    return amplitude * (CEILING / total), True


def below_full_scale(vibration: FloatArray) -> tuple[FloatArray, int]:
    """Return the samples with those beyond the knee rounded off, and how many there were."""
    size = np.abs(vibration)
    if size.max(initial=0.0) <= KNEE:
        return vibration, 0
    room = 1.0 - KNEE
    over = size > KNEE
    rounded = KNEE + room * np.tanh((size - KNEE) / room) * (1.0 - 1e-6)
    return np.where(over, np.copysign(rounded, vibration), vibration), int(over.sum())
