"""Onsets in the 5 ms before each tick: "Onsets do not wait for the long window" in
docs/transform.md. A group is neighbouring bands: the first, and past the last."""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import rfft

from audioflinger_hook.transform.arrays import FloatArray, IntArray


class Onsets:
    """The onsets in band-passed sound (frames,), in ticks that end before these frames.
    onset: (ticks,) the latest onset as the number of its tick, -1 before the first."""

    def __init__(self, s: Any, sound: FloatArray, ends: IntArray) -> None:
        self.s, self.edges = s, s.band_edges.astype(int)
        padded = np.concatenate((np.zeros(s.short_frames), sound))
        windows = sliding_window_view(padded, s.short_frames)[ends]
        squares = windows[:, s.short_frames - s.tick_frames :] ** 2
        newest = squares[:, s.tick_frames - s.newest_frames :]
        self.newest = np.maximum(squares.mean(axis=1), newest.mean(axis=1))
        self.peak = np.sqrt(squares.max(axis=1))
        spectra = rfft(windows * s.short_window, s.short_length)[:, : s.short_bins]
        self.power = (spectra.real**2 + spectra.imag**2) * s.short_scale
        # A window counts as silence where all of its ticks are weaker than the faintest onset.
        ago = [np.pad(self.peak, (tick, 0))[: len(ends)] for tick in range(s.short_ticks)]
        self.power[np.max(ago, axis=0) ** 2 < s.quietest] = 0.0
        self.bands = np.add.reduceat(self.power, self.edges[:-1], axis=1)
        self.onset, self.rising = onsets_by_tick(s, self.bands)

    def known(self, tick: int) -> tuple[FloatArray, float]:
        """Return the powers (bins,) since the onset, and its amplitude as that of one tone."""
        first = self.onset[tick]
        since = slice(first, min(tick + 1, first + self.s.heard_ticks))
        level = min(np.sqrt(2.0 * self.newest[since].max()), self.peak[since].max())
        return self.power[since].sum(axis=0), float(level)

    def groups(self, tick: int) -> list[tuple[int, int]]:
        """Return the groups of bands that rose, from valley to valley: the strongest ones."""
        power, _ = self.known(tick)
        bands = np.add.reduceat(power, self.edges[:-1]) * self.rising[self.onset[tick]]
        falls = bands[:-1] > self.s.apart_from * bands[1:]
        # A valley belongs to the group under it.
        cuts = [0, *(2 + np.flatnonzero(falls[:-1] & ~falls[1:])).tolist(), bands.size]
        groups = sorted(pairwise(cuts), key=lambda group: -bands[slice(*group)].sum())
        return sorted(group for group in groups[: self.s.groups_max] if bands[slice(*group)].any())

    def estimate(self, tick: int, group: tuple[int, int]) -> tuple[float, float]:
        """Return vibration frequency in Hz and weight of what began in a group of bands: the share
        of the level that the amplitude mapping would leave, 0 of what is too weak for it."""
        s, onset = self.s, self.onset[tick]
        bins, level = self.known(tick)
        total = float(bins.sum())
        edges = [0, *self.edges[1:-1]]  # the lowest band has what is under it
        power, squares, weighted = (
            float(np.add.reduceat(each, edges)[slice(*group)] @ self.rising[onset, slice(*group)])
            for each in (bins, bins**2, bins**2 * s.short_hz)
        )
        hz, share = weighted / max(squares, 1e-300), min(1.0, power / max(total, 1e-300))
        one_tone = power**2 * s.one_tone[min(tick - onset, s.heard_ticks - 1)]
        # Where loudness is followed, noise is as strong as it is loud.
        purity = 1.0 if s.loudness_scale.size else min(1.0, squares / max(one_tone, 1e-300))
        by_energy = (share * purity) ** 0.5
        weight = by_energy if s.energy_mapping else share**1.5 * purity
        return hz, 0.0 if by_energy * level < s.weakest else float(weight)

    def recent_power(self, tick: int, group: tuple[int, int]) -> float:
        """Return the power of a group of bands, the highest of the last ticks in each band."""
        recent = self.bands[max(0, tick + 1 - self.s.back_ticks) : tick + 1]
        return float(recent.max(axis=0)[slice(*group)].sum())


def onsets_by_tick(s: Any, bands: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the latest onset in each tick, and which bands rise, from bands (ticks, bands)."""
    past = np.concatenate((np.zeros((s.back_ticks, bands.shape[1])), bands))
    onset, rising = np.full(len(bands), -1), np.zeros(bands.shape)
    latest, highest = -1 - s.rest_ticks, np.zeros(bands.shape[1])
    for tick, now in enumerate(bands):
        highest = np.maximum(highest * s.fading, past[tick])
        highest[highest < s.forgotten] = 0.0
        rising[tick] = (now > s.rise * highest) & (now > s.minor * now.sum())
        risen, since = (now * rising[tick]).sum(), tick - latest
        # So soon after an onset only a far stronger one counts.
        before = past[tick + s.back_ticks - (2 if since >= s.rearmed_ticks else 1)].sum()
        armed = s.find_onsets and (since >= s.rest_ticks or risen > s.rearmed * before)
        if armed and risen > s.quietest and risen > s.risen_share * now.sum():
            latest, highest = tick, np.maximum(highest, now)
        onset[tick] = max(latest, -1)
    return onset, rising
