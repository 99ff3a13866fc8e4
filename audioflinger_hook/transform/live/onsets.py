"""Onsets: a short window every two milliseconds says that something begins, and where.

The long window of the analysis knows a sound's frequencies, but only when it is full of it. Here a
window of 5 ms, most of it before its own peak, is looked at in some ten bands. What rises there
well over all that the band had of late is an onset; what it consists of is told roughly, and
better with each of the next windows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len, rfft

from audioflinger_hook.transform.arrays import FloatArray, strided_windows
from audioflinger_hook.transform.design import LiveGrid
from audioflinger_hook.transform.mapping import vibration_hz
from audioflinger_hook.transform.parameters import TransformParameters

OLD_SIDE_S, NEW_SIDE_S = 0.004, 0.001
"""The window rises for so long and falls for so long: what is newest counts at once."""

EDGES_HZ = (200, 400, 600, 800, 1_200, 1_800, 2_600, 3_800, 5_600, 8_200, 12_000)
"""Of the bands. Under the first there is no telling a swing from a shift of the mean."""

RISE = 4.0
"""A band rises where its power is so many times the highest of late (6 dB), ..."""

FORGOTTEN_DB_A_S = 300.0
"""... which is forgotten at this rate: a level that swells from nothing ten times a
second is no onset, what begins after 30 ms of rest is."""

BACK_TICKS = 3
"""So many ticks ago is the past that a band rises over."""

RISEN_SHARE = 0.5
"""What rose has to be more than this share of all power now."""

REST_TICKS = 5
"""From one onset to the next, ..."""

REARMED_TICKS, REARMED = 3, 10.0
"""... but for what has so many times the power of a tick before, later of two before: then only the
very first of a sound was told, or a faint one before it, and it is told anew."""

HEARD_TICKS = 4
"""An onset's sound is told from so many windows, each better than the last."""

LOWEST_HZ = 70.0
"""What the window's lowest bin stands for: half a period of 70 Hz is all that it can hold."""

QUIETEST, WEAKEST = 0.02, 0.5
"""Shares of the weakest steady tone that is principal: what is quieter is no onset, and what is
weaker is not felt."""

GROUPS = 4
"""Groups of bands that an onset gives birth in at most ..."""

ONSET_PARTIALS_MAX = 2 * GROUPS
"""... and partials that are fresh at a time."""

MINOR = 0.01
"""Share of all power from which on a band rises: side lobes of the window are less."""

APART_FROM = 1.0 + 1e-9
"""Bands are told apart from this ratio on, so that rounding decides nothing between equals."""

ONE_TONE = (0.12, 0.28, 0.34, 0.36)
"""Sum p^2 / (sum p)^2 over the bins' powers p of a tone, after the first window of an onset, the
second and so on. In noise it is a tenth of it: there is so much in a group of bands."""

FORGOTTEN = 1e-30
"""A power that is as good as none."""

TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Ticks:
    """What is seen in each of several ticks: arrays with one row or entry a tick.

    power: (ticks, bins) of the short window's spectrum, as mean squares; bands: (ticks, bands),
    its sums; newest: (ticks,) mean square of what is newest; peak: (ticks,) largest magnitude.
    """

    power: FloatArray
    bands: FloatArray
    newest: FloatArray
    peak: FloatArray

    @classmethod
    def silent(cls, ticks: int) -> Ticks:
        """Return what is seen of silence, in no band at all."""
        return cls(*np.zeros((2, ticks, 0)), *np.zeros((2, ticks)))


class OnsetDetector:
    """Finds onsets in band-passed sound, tick by tick; the past is forgotten by `reset`.

    Held by one thread at a time.
    """

    def __init__(self, parameters: TransformParameters, grid: LiveGrid) -> None:
        rate = grid.samplerate
        old, new = (max(1, round(side * rate)) for side in (OLD_SIDE_S, NEW_SIDE_S))
        self.window_frames = old + new
        self.window_ticks = -(-self.window_frames // grid.tick_frames)
        self.fft_length = _even_fast_length(self.window_frames)
        self._window = np.concatenate(
            (
                0.5 - 0.5 * np.cos(np.pi * (np.arange(old) + 0.5) / old),
                0.5 + 0.5 * np.cos(np.pi * (np.arange(new) + 0.5) / new),
            )
        )
        bin_hz = rate / self.fft_length
        nyquist = self.fft_length // 2
        # From bins to mean squares, by Parseval; a real spectrum has each bin twice.
        self._scale = 2.0 / (self.fft_length * float(self._window @ self._window))
        edges = {min(max(1, round(edge / bin_hz)), nyquist) for edge in EDGES_HZ}
        edges.add(min(max(2, round(parameters.band_high_hz / bin_hz)), nyquist))
        self.edges = sorted(edges)
        self.bins = self.edges[-1]
        hz = np.maximum(np.arange(self.bins) * bin_hz, LOWEST_HZ)
        self.bin_hz = vibration_hz(
            np.clip(hz, parameters.band_low_hz, parameters.band_high_hz), parameters
        )
        weakest = parameters.heard_threshold_hz / parameters.unit_strength_hz(rate)
        self._by_energy = parameters.level_law == "energy"
        self.quietest = 0.5 * (QUIETEST * weakest) ** 2
        self.weakest = WEAKEST * weakest
        self._fading = 10 ** (-FORGOTTEN_DB_A_S * grid.tick_frames / rate / 10)
        self._half = max(1, grid.tick_frames // 2)
        self.reset()

    def reset(self) -> None:
        """Forget what was heard."""
        self._peaks = np.zeros(self.window_ticks - 1)
        bands = len(self.edges) - 1
        self._past = np.zeros((BACK_TICKS, bands))
        self._highest = np.zeros(bands)
        self._since = REST_TICKS
        self._power = np.zeros(self.bins)
        self._newest = 0.0
        self._peak = 0.0

    def see(self, windows: FloatArray, ticks: FloatArray) -> Ticks:
        """Return what is seen in band-passed windows (rows, window_frames), ticks (rows, frames).

        To be called once for each tick, in order. Where all ticks that a window touches stay under
        the quietest onset, it is taken for silence.
        """
        squares = ticks * ticks
        newest = np.maximum(
            squares.sum(axis=1) / squares.shape[1],
            squares[:, -self._half :].sum(axis=1) / self._half,
        )
        peak = np.abs(ticks).max(axis=1)
        power = np.zeros((len(windows), self.bins))
        peaks = np.concatenate((self._peaks, peak))
        self._peaks = peaks[peak.size :]
        loudest = strided_windows(peaks, self.window_ticks, 1).max(axis=1)
        heard = (loudest * loudest >= self.quietest).nonzero()[0]
        if heard.size:
            spectra = rfft(windows[heard] * self._window, self.fft_length, axis=1)[:, : self.bins]
            power[heard] = (spectra.real**2 + spectra.imag**2) * self._scale
        bands = np.add.reduceat(power, self.edges[:-1], axis=1)
        return Ticks(power, bands, newest, peak)

    def hear(self, ticks: Ticks, tick: int) -> bool:
        """Take one tick and return whether there is an onset in it."""
        bands = ticks.bands[tick]
        self._highest = np.maximum(self._highest * self._fading, self._past[0])
        self._highest[self._highest < FORGOTTEN] = 0.0
        self._past = np.concatenate((self._past[1:], bands[None]))
        total = _in_order(bands)
        rising = (bands > RISE * self._highest) & (bands > MINOR * total)
        risen = _in_order(bands * rising)
        self._since += 1
        before = self._past[BACK_TICKS - (3 if self._since >= REARMED_TICKS else 2)]
        armed = self._since >= REST_TICKS or risen > REARMED * _in_order(before)
        onset = armed and risen > self.quietest and risen > RISEN_SHARE * total
        if onset:
            self._since = 0
            self._highest = np.maximum(self._highest, bands)
            self._power = np.zeros(self.bins)
            self._newest = self._peak = 0.0
            self._rising = rising
        if self.still_told:
            self._power = self._power + ticks.power[tick]
            self._newest = max(self._newest, float(ticks.newest[tick]))
            self._peak = max(self._peak, float(ticks.peak[tick]))
        return bool(onset)

    def rest(self, ticks: int) -> None:
        """Take so many ticks of silence."""
        for _ in range(ticks):
            self._highest = np.maximum(self._highest * self._fading, self._past[0])
            self._highest[self._highest < FORGOTTEN] = 0.0
            self._past = np.concatenate((self._past[1:], np.zeros((1, self._highest.size))))
            self._since += 1

    @property
    def still_told(self) -> bool:
        """Whether the last onset's sound is told better by this tick than by the one before."""
        return self._since < HEARD_TICKS

    def groups(self) -> list[tuple[int, int]]:
        """Return the bands, first and past the last, of each thing that begins.

        Bands from valley to valley, the strongest `GROUPS` of them by frequency; only what rose.
        """
        bands = np.add.reduceat(self._power, self.edges[:-1]) * self._rising
        found, first = [], 0
        for band in range(1, bands.size - 1):
            # A valley belongs to what is under it.
            here = APART_FROM * bands[band]
            if here < bands[band - 1] and not APART_FROM * bands[band + 1] < bands[band]:
                found.append((first, band + 1))
                first = band + 1
        found.append((first, bands.size))
        loud = [(float(bands[slice(*group)].sum()), group) for group in found]
        loud = sorted((one for one in loud if one[0] > 0.0), key=lambda one: -one[0])[:GROUPS]
        return sorted(group for _, group in loud)

    def told(self, group: tuple[int, int]) -> tuple[float, float]:
        """Return vibration frequency in Hz and weight of what begins in a group of bands.

        The weight is what the law would leave of `level`, which is the amplitude as of one tone; 0
        of what is too weak to be principal.
        """
        weighted, squares, power = 0.0, 0.0, 0.0
        for band in range(*group):
            if self._rising[band]:
                # The lowest band tells more with what is under it.
                bins = slice(self.edges[band] if band else 0, self.edges[band + 1])
                square = self._power[bins] ** 2
                weighted += float((square * self.bin_hz[bins]).sum())
                squares += float(square.sum())
                power += float(self._power[bins].sum())
        share = min(1.0, power / max(float(self._power.sum()), TINY))
        one = ONE_TONE[min(self._since, HEARD_TICKS - 1)]
        purity = min(1.0, squares / max(power * power * one, TINY))
        hz = weighted / max(squares, TINY)
        by_energy = float(np.sqrt(share * purity))
        if by_energy * self.level < self.weakest:
            return hz, 0.0
        # Of M equal tones of amplitude a each sounds with a / M, as by r^2 / sum r.
        weight = by_energy if self._by_energy else share * float(np.sqrt(share)) * purity
        return hz, weight

    @property
    def level(self) -> float:
        """Amplitude of the sound that begins, as that of one tone."""
        return min(float(np.sqrt(2.0 * self._newest)), self._peak)

    def loudness(self, group: tuple[int, int]) -> float:
        """Return the power that a group of bands has had of late."""
        return float(self._past.max(axis=0)[slice(*group)].sum())


def _in_order(values: FloatArray) -> float:
    total = 0.0
    for value in values.tolist():
        total += value
    return total


def _even_fast_length(frames: int) -> int:
    length = max(4, frames)
    while next_fast_len(length, real=True) != length or length % 2:
        length += 1
    return length
