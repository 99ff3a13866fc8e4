"""Design of the loudness of each tick: bands of ISO 532-1, their powers, groups of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.core.rounding import round_sections
from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design.analysis import OnsetDesign
from audioflinger_hook.transform.design.synthesis import LiveGrid
from audioflinger_hook.transform.filters import BUTTERWORTH_5, low_pass

FULL_SCALE_DB = 94.0
"""Sound pressure level that a full-scale tone stands for; loudness in phon counts from here."""

BANDS_HZ = (
    *(90.0, 180.0, 280.0, 355.0, 450.0, 560.0, 710.0, 900.0, 1_120.0, 1_400.0),
    *(1_800.0, 2_240.0, 2_800.0, 3_550.0, 4_500.0, 5_600.0, 7_100.0, 9_000.0, 11_200.0, 12_000.0),
)
"""Upper edges of the 20 bands of ISO 532-1: thirds of an octave from 280 Hz up. The last ends at
15.5 kHz there; the band-pass ends it sooner."""

BARKS = (
    *(0.9, 1.8, 2.8, 3.5, 4.4, 5.4, 6.6, 7.9, 9.2, 10.6),
    *(12.3, 13.8, 15.2, 16.7, 18.1, 19.3, 20.6, 21.8, 22.7, 23.6),
)
"""The same edges as critical-band rates, table 3 of ISO 532-1."""

QUIET_DB = np.array((30.0, 18.0, 12.0, 8.0, 7.0, 6.0, 5.0, 4.0) + 12 * (3.0,)) - 15.0
"""Threshold in quiet, band by band, 15 dB under that of ISO 532-1. The listener's volume is not
known: a lower volume should change all loudness alike."""

OUTER_EAR_DB = np.array(10 * (0.0,) + (-0.5, -1.6, -3.2, -5.4, -5.6, -4.0, -1.5, 2.0, 5.0, 12.0))
"""Attenuation by the outer ear."""

BANDWIDTH_DB = np.array(
    (
        *(-0.25, -0.6, -0.8, -0.8, -0.5, 0.0, 0.5, 1.1, 1.5, 1.7),
        *(1.8, 1.8, 1.7, 1.6, 1.4, 1.2, 0.8, 0.5, 0.0, -0.5),
    )
)
"""From the level in a third of an octave to the level in a critical band."""

OVER_QUIET_DB = FULL_SCALE_DB - OUTER_EAR_DB - BANDWIDTH_DB - QUIET_DB
"""From a tone's level in full scale to its excitation over the threshold in quiet."""

DEEP_HZ, DEEP_DB = (25.0, 65.0, 90.0), (7.0, -6.0, -6.0)
"""Deep sound is felt more than heard: bands under 90 Hz count so many dB more, by frequency. Where
less, it is as the ear weighs them in ISO 532-1."""

LOW_EDGES_HZ = (20.0, 45.0, 90.0, 180.0, 280.0, 355.0, 450.0, 560.0)
"""Edges of the bands that have filters of their own. Both of the first belong to the first band of
ISO 532-1, in which they are not weighed alike."""

LOW_BAND_OF = (0, 0, 1, 2, 3, 4, 5)  # their bands of ISO 532-1
# Their windows are longer than those of the other bands: so much louder would a short sound be.
LOW_DB = -1.0
# Two equal poles are 3 dB down about at a band's edges if each has so many times its width.
POLE_WIDTH = 1.3
LOW_TOP_HZ = 850.0  # where the low-pass before the low rate ends

QUADRATURE = (
    (0.6923878, 0.9360654322959, 0.9882295226860, 0.9987488452737),
    (0.4021921162426, 0.8561710882420, 0.9722909545651, 0.9952884791278),
)
"""Two chains of all-passes, a sample apart, that differ by a quarter of a turn: Olli Niemitalo,
"Hilbert transform". The image is 44 dB down."""

GROUPS = (0, 1, 3, 6, 9, 12, 14, 16, 20)
"""Bands at which groups begin, and past the last: edges at 90, 280, 560, 1120, 2240, 4500, 7100
Hz."""


@dataclass(frozen=True, eq=False)
class LoudnessDesign:
    """How loud a tick is. All tables are empty where loudness is not followed."""

    low_smooth: FloatArray  # low-pass before the low rate: second-order sections, (sections, 6)
    quadrature: FloatArray  # squares of the all-passes' coefficients, (2, 4)
    low_poles: FloatArray  # (low bands, 3): real and imaginary part of the pole, gain before it
    low_weights: FloatArray  # of each low band: from the squares' sum over a tick to excitation
    low_band_of: FloatArray  # of each low band: number of its band of loudness
    high_edges: FloatArray  # bins of the short window: the first of each high band, past the last
    high_weights: FloatArray  # of each high band: factor from its mean square to its excitation
    loudness_scale: FloatArray  # of each band: sone per Bark at its threshold
    loudness_widths: FloatArray  # of each band: Bark
    loudness_groups: FloatArray  # bands: the first of each group, and past the last
    # Ticks over which the powers of high bands are averaged. Over three of them, a tone's power in
    # the onset search's window of 5 ms hardly wavers with its phase.
    average_ticks: int = 3
    # Above a band its specific loudness N' falls by this / N'^0.25 of itself for each Bark: nearly
    # what the table of slopes in ISO 532-1 says.
    slope_a_bark: float = 0.45

    @property
    def delay_ticks(self) -> float:
        """Ticks by which the strength of an onset follows on average.

        It goes on a line over a tick. It is in proportion to sone, the average's power of 0.3.
        """
        shares = np.arange(1, self.average_ticks) / self.average_ticks
        return 0.5 + float((1.0 - shares**0.3).sum())

    @classmethod
    def of(
        cls, followed: bool, grid: LiveGrid, onsets: OnsetDesign, samplerate: int
    ) -> LoudnessDesign:
        """Return the design for a grid and the short windows of a samplerate in Hz."""
        if not followed:
            return cls(*10 * (np.zeros(0),))
        low_rate_hz = samplerate / grid.decimation
        lows = [low for low, top in enumerate(LOW_EDGES_HZ[1:]) if top < low_rate_hz / 2]
        edges, highs = _high_bands(onsets, samplerate / onsets.short_length)
        bands = [*dict.fromkeys(LOW_BAND_OF[low] for low in lows), *highs]
        quiet_db, groups = QUIET_DB[bands], np.searchsorted(bands, GROUPS)
        widths = np.diff((0.0, *BARKS))[bands]
        smooth = np.zeros(0)
        if 0.4 * low_rate_hz > LOW_TOP_HZ and grid.decimation > 1:
            smooth = round_sections(*low_pass(BUTTERWORTH_5, LOW_TOP_HZ, samplerate))
        return cls(
            low_smooth=smooth,
            quadrature=np.array(QUADRATURE) ** 2,
            low_poles=np.array([_pole(low, low_rate_hz) for low in lows]),
            low_weights=np.array([_low_weight(low) for low in lows]) / grid.tick_steps,
            low_band_of=np.array([LOW_BAND_OF[low] for low in lows], dtype=np.float64),
            high_edges=np.array(edges, dtype=np.float64),
            # The mean square of a full-scale tone is a half.
            high_weights=2.0 * 10.0 ** (0.1 * OVER_QUIET_DB[highs]),
            loudness_scale=0.0635 * 10.0 ** (0.025 * quiet_db),
            loudness_widths=widths,
            loudness_groups=np.unique(groups).astype(np.float64),
        )


def _pole(low: int, low_rate_hz: float) -> tuple[float, float, float]:
    below_hz, above_hz = LOW_EDGES_HZ[low : low + 2]
    radius = math.exp(-math.pi * POLE_WIDTH * (above_hz - below_hz) / low_rate_hz)
    turn = math.pi * (below_hz + above_hz) / low_rate_hz
    return radius * math.cos(turn), radius * math.sin(turn), 1.0 - radius


def _low_weight(low: int) -> float:
    """Return the factor from a tone's mean square of the analytic signal to its excitation."""
    over_db = float(OVER_QUIET_DB[LOW_BAND_OF[low]]) + LOW_DB
    if LOW_BAND_OF[low] == 0:
        over_db += float(np.interp(sum(LOW_EDGES_HZ[low : low + 2]) / 2, DEEP_HZ, DEEP_DB))
    return math.pow(10.0, 0.1 * over_db)


def _high_bands(onsets: OnsetDesign, bin_hz: float) -> tuple[list[int], list[int]]:
    """Return the edges in bins of the bands over the low ones, and their numbers."""
    edges, bands = [round(LOW_EDGES_HZ[-1] / bin_hz)], list[int]()
    for band in range(LOW_BAND_OF[-1] + 1, len(BANDS_HZ)):
        edge = max(edges[-1] + 1, round(BANDS_HZ[band] / bin_hz))
        if edges[-1] < onsets.short_bins:
            edges.append(min(edge, onsets.short_bins))
            bands.append(band)
    return (edges if bands else []), bands
