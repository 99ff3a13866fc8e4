"""Onsets: a short window every two milliseconds finds what begins, and its frequencies roughly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft

from audioflinger_hook.transform.arrays import FloatArray, strided_windows
from audioflinger_hook.transform.design.analysis import OnsetDesign

TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Ticks:
    """Measurements of several ticks: arrays with one row or entry a tick.

    power: (ticks, bins) of the short window's spectrum, as mean squares; bands: (ticks, bands),
    its sums; newest: (ticks,) mean square of the newest frames; peak: (ticks,) largest magnitude.
    """

    power: FloatArray
    bands: FloatArray
    newest: FloatArray
    peak: FloatArray

    @classmethod
    def silent(cls, ticks: int) -> Ticks:
        """Return the measurements of silence, without bands."""
        return cls(*np.zeros((2, ticks, 0)), *np.zeros((2, ticks)))


class OnsetDetector:
    """Finds onsets in band-passed sound, tick by tick.

    by_energy: whether amplitudes are mapped by energy. Use from one thread at a time.
    """

    def __init__(self, design: OnsetDesign, by_energy: bool, followed: bool) -> None:
        self._design = design
        self._by_energy = by_energy
        self._followed = followed
        self._edges = [int(edge) for edge in design.band_edges]
        self._one_tone = design.one_tone.tolist()
        self.reset()

    def reset(self) -> None:
        """Return to the state of a new stream."""
        design = self._design
        self._peaks = np.zeros(design.short_ticks - 1)
        bands = len(self._edges) - 1
        self._past = np.zeros((design.back_ticks, bands))
        self._highest = np.zeros(bands)
        self._since = design.rest_ticks
        self._power = np.zeros(design.short_bins)
        self._newest = 0.0
        self._peak = 0.0

    def measure(self, windows: FloatArray, ticks: FloatArray) -> Ticks:
        """Return the measurements of band-passed windows (rows, window) and ticks (rows, frames).

        To be called once for each tick, in order. A window counts as silence where all ticks that
        it touches stay under the quietest onset.
        """
        design = self._design
        squares = ticks * ticks
        newest = np.maximum(
            squares.sum(axis=1) / squares.shape[1],
            squares[:, -design.newest_frames :].sum(axis=1) / design.newest_frames,
        )
        peak = np.abs(ticks).max(axis=1)
        power = np.zeros((len(windows), design.short_bins))
        peaks = np.concatenate((self._peaks, peak))
        self._peaks = peaks[peak.size :]
        loudest = strided_windows(peaks, design.short_ticks, 1).max(axis=1)
        audible = (loudest * loudest >= design.quietest).nonzero()[0]
        if audible.size:
            spectra = rfft(windows[audible] * design.short_window, design.short_length, axis=1)
            spectra = spectra[:, : design.short_bins]
            power[audible] = (spectra.real**2 + spectra.imag**2) * design.short_scale
        bands = np.add.reduceat(power, self._edges[:-1], axis=1)
        return Ticks(power, bands, newest, peak)

    def detect(self, ticks: Ticks, tick: int) -> bool:
        """Take one tick and return whether there is an onset in it."""
        design = self._design
        bands = ticks.bands[tick]
        self._highest = np.maximum(self._highest * design.fading, self._past[0])
        self._highest[self._highest < design.forgotten] = 0.0
        self._past = np.concatenate((self._past[1:], bands[None]))
        total = _sum_in_order(bands)
        rising = (bands > design.rise * self._highest) & (bands > design.minor * total)
        risen = _sum_in_order(bands * rising)
        self._since += 1
        back = 3 if self._since >= design.rearmed_ticks else 2
        before = self._past[design.back_ticks - back]
        armed = self._since >= design.rest_ticks or risen > design.rearmed * _sum_in_order(before)
        onset = armed and risen > design.quietest and risen > design.risen_share * total
        if onset:
            self._since = 0
            self._highest = np.maximum(self._highest, bands)
            self._power = np.zeros(design.short_bins)
            self._newest = self._peak = 0.0
            self._rising = rising
        if self.is_measuring:
            self._power = self._power + ticks.power[tick]
            self._newest = max(self._newest, float(ticks.newest[tick]))
            self._peak = max(self._peak, float(ticks.peak[tick]))
        return bool(onset)

    def rest(self, ticks: int) -> None:
        """Take so many ticks of silence."""
        for _ in range(ticks):
            self._highest = np.maximum(self._highest * self._design.fading, self._past[0])
            self._highest[self._highest < self._design.forgotten] = 0.0
            self._past = np.concatenate((self._past[1:], np.zeros((1, self._highest.size))))
            self._since += 1

    @property
    def is_measuring(self) -> bool:
        """Whether this tick still improves the estimate of the last onset."""
        return self._since < self._design.heard_ticks

    def groups(self) -> list[tuple[int, int]]:
        """Return the groups of bands that rose: the first of each, and past the last.

        A group reaches from valley to valley. The strongest `groups_max` count, by frequency.
        """
        design = self._design
        bands = np.add.reduceat(self._power, self._edges[:-1]) * self._rising
        found, first = [], 0
        for band in range(1, bands.size - 1):
            # A valley belongs to the group under it.
            here = design.apart_from * bands[band]
            if here < bands[band - 1] and not design.apart_from * bands[band + 1] < bands[band]:
                found.append((first, band + 1))
                first = band + 1
        found.append((first, bands.size))
        loud = [(float(bands[slice(*group)].sum()), group) for group in found]
        loud = sorted((one for one in loud if one[0] > 0.0), key=lambda one: -one[0])[
            : design.groups_max
        ]
        return sorted(group for _, group in loud)

    def estimate(self, group: tuple[int, int]) -> tuple[float, float]:
        """Return the vibration frequency in Hz and the weight of an onset in a group of bands.

        The weight is the share of `level` that the amplitude mapping would leave; 0 for an onset
        that is too weak to be principal.
        """
        design = self._design
        weighted, squares, power = 0.0, 0.0, 0.0
        for band in range(*group):
            if self._rising[band]:
                # The lowest band includes the bins under it.
                bins = slice(self._edges[band] if band else 0, self._edges[band + 1])
                square = self._power[bins] ** 2
                weighted += float((square * design.short_hz[bins]).sum())
                squares += float(square.sum())
                power += float(self._power[bins].sum())
        share = min(1.0, power / max(float(self._power.sum()), TINY))
        one = self._one_tone[min(self._since, design.heard_ticks - 1)]
        purity = min(1.0, squares / max(power * power * one, TINY))
        hz = weighted / max(squares, TINY)
        if self._followed:
            # Noise is as strong as it is loud; its purity does not count.
            purity = 1.0
        by_energy = float(np.sqrt(share * purity))
        if by_energy * self.level < design.weakest:
            return hz, 0.0
        # Each of M equal tones of amplitude a gets a / M, as by r^2 / sum r.
        weight = by_energy if self._by_energy else share * float(np.sqrt(share)) * purity
        return hz, weight

    @property
    def power(self) -> FloatArray:
        """Powers of the bins since the onset, (bins,)."""
        return self._power

    @property
    def level(self) -> float:
        """Amplitude of the onset, as that of one tone."""
        return min(float(np.sqrt(2.0 * self._newest)), self._peak)

    def recent_power(self, group: tuple[int, int]) -> float:
        """Return the highest recent power of a group of bands."""
        return float(self._past.max(axis=0)[slice(*group)].sum())


def _sum_in_order(values: FloatArray) -> float:
    total = 0.0
    for value in values.tolist():
        total += value
    return total
