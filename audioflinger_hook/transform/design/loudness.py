"""Constants and tables for the measurement of loudness in each tick, in the bands of ISO 532-1."""

import math
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.core.rounding import round_sections
from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design.analysis import OnsetDesign
from audioflinger_hook.transform.design.synthesis import LiveGrid
from audioflinger_hook.transform.filters import BUTTERWORTH_5, low_pass

FULL_SCALE_DB = 94.0  # assumed sound pressure level of a full-scale tone, dB re 20 uPa

BANDS_HZ = (
    *(90.0, 180.0, 280.0, 355.0, 450.0, 560.0, 710.0, 900.0, 1_120.0, 1_400.0),
    *(1_800.0, 2_240.0, 2_800.0, 3_550.0, 4_500.0, 5_600.0, 7_100.0, 9_000.0, 11_200.0, 12_000.0),
)
"""Upper edges of the 20 bands of ISO 532-1, third-octave bands from 280 Hz up. The last band ends
at 12 kHz, the default end of the band-pass, instead of 15.5 kHz."""

BARKS = (
    *(0.9, 1.8, 2.8, 3.5, 4.4, 5.4, 6.6, 7.9, 9.2, 10.6),
    *(12.3, 13.8, 15.2, 16.7, 18.1, 19.3, 20.6, 21.8, 22.7, 23.6),
)
"""Upper edges of the bands as critical-band rates in Bark (ISO 532-1)."""

QUIET_DB = np.array((30.0, 18.0, 12.0, 8.0, 7.0, 6.0, 5.0, 4.0) + 12 * (3.0,)) - 15.0
"""Threshold in quiet of each band, 15 dB lower than in ISO 532-1. The listener's volume is unknown.
With a lower threshold, a change of volume changes the loudness of all sounds by more similar
factors."""

OUTER_EAR_DB = np.array(10 * (0.0,) + (-0.5, -1.6, -3.2, -5.4, -5.6, -4.0, -1.5, 2.0, 5.0, 12.0))
"""Attenuation by the outer ear in each band."""

BANDWIDTH_DB = np.array(
    (
        *(-0.25, -0.6, -0.8, -0.8, -0.5, 0.0, 0.5, 1.1, 1.5, 1.7),
        *(1.8, 1.8, 1.7, 1.6, 1.4, 1.2, 0.8, 0.5, 0.0, -0.5),
    )
)
"""Difference between the level in a third-octave band and the level in a critical band."""

OVER_QUIET_DB = FULL_SCALE_DB - OUTER_EAR_DB - BANDWIDTH_DB - QUIET_DB
"""Excitation of a full-scale tone in each band, in dB above the threshold in quiet."""

DEEP_HZ, DEEP_DB = (25.0, 65.0, 90.0), (7.0, -6.0, -6.0)
"""Correction in dB of the excitation below 90 Hz, interpolated by frequency. Positive values stand
for bass that the body feels."""

LOW_EDGES_HZ = (20.0, 45.0, 90.0, 180.0, 280.0, 355.0, 450.0, 560.0)
"""Edges of the low bands, which have their own filters. Other bands use the onset window."""

LOW_BAND_OF = (0, 0, 1, 2, 3, 4, 5)  # band of ISO 532-1 that contains each low band
LOW_DB = -1.0  # correction of the low bands, dB
POLE_WIDTH = 1.3  # -3 dB width of one pole, in band widths; two poles have noise bandwidth 1
LOW_TOP_HZ = 850.0  # end of the pass band of the low-pass before decimation

QUADRATURE = (
    (0.6923878, 0.9360654322959, 0.9882295226860, 0.9987488452737),
    (0.4021921162426, 0.8561710882420, 0.9722909545651, 0.9952884791278),
)
"""Coefficients of two all-pass chains for an analytic signal with an image of -44 dB. With one
chain delayed by a sample, the phases differ by 90 degrees. Source: Olli Niemitalo, "Hilbert
transform"."""

GROUPS = (0, 1, 3, 6, 9, 12, 14, 16, 20)
"""First band of each group, then the end of the last group. The edges between groups are 90, 280,
560, 1120, 2240, 3550 and 5600 Hz."""


@dataclass(frozen=True, eq=False)
class LoudnessDesign:
    """Constants and tables of the loudness measurement; empty tables without loudness control."""

    low_smooth: FloatArray  # low-pass before decimation, see `_smoothing`
    quadrature: FloatArray  # squares of the all-pass coefficients, (2, 4)
    low_poles: FloatArray  # real part, imaginary part and gain of the pole of each low band, (n, 3)
    low_weights: FloatArray  # factor from the sum of squares in a tick to excitation, per low band
    low_band_of: FloatArray  # number of the loudness band that contains each low band
    high_edges: FloatArray  # first bin of each high band in the onset window, then the end
    high_weights: FloatArray  # factor from mean square to excitation, per high band
    loudness_scale: FloatArray  # sone per Bark at the threshold, per band
    loudness_widths: FloatArray  # width in Bark, per band
    loudness_groups: FloatArray  # first band of each group, then the end of the last group
    # The powers of high bands are averaged over three ticks, because the power in one onset window
    # of 5 ms depends on a tone's phase.
    average_ticks: int = 3
    # Above a band, the specific loudness N' decreases by slope_a_bark N'^0.75 per Bark. This
    # approximates the slopes of ISO 532-1.
    slope_a_bark: float = 0.45

    @property
    def delay_ticks(self) -> float:
        """Mean delay, in ticks, of the rise of loudness (power^0.3) at an onset."""
        shares = np.arange(1, self.average_ticks) / self.average_ticks
        return 0.5 + float((1.0 - shares**0.3).sum())

    @classmethod
    def of(
        cls, followed: bool, grid: LiveGrid, onsets: OnsetDesign, samplerate: int
    ) -> "LoudnessDesign":
        """Return the design for a time grid and a samplerate in Hz."""
        if not followed:
            return cls(*10 * (np.zeros(0),))
        low_rate_hz = samplerate / grid.decimation
        lows = [low for low, top in enumerate(LOW_EDGES_HZ[1:]) if top < low_rate_hz / 2]
        edges, highs = _high_bands(onsets, samplerate / onsets.short_length)
        bands = [*dict.fromkeys(LOW_BAND_OF[low] for low in lows), *highs]
        quiet_db, groups = QUIET_DB[bands], np.searchsorted(bands, GROUPS)
        return cls(
            low_smooth=_smoothing(grid.decimation, samplerate),
            quadrature=np.array(QUADRATURE) ** 2,
            low_poles=np.array([_pole(low, low_rate_hz) for low in lows]),
            low_weights=np.array([_low_weight(low) for low in lows]) / grid.tick_steps,
            low_band_of=np.array([LOW_BAND_OF[low] for low in lows], dtype=np.float64),
            high_edges=np.array(edges, dtype=np.float64),
            # The factor 2 is the inverse of the mean square of a full-scale tone.
            high_weights=2.0 * 10.0 ** (0.1 * OVER_QUIET_DB[highs]),
            loudness_scale=0.0635 * 10.0 ** (0.025 * quiet_db),
            loudness_widths=np.diff((0.0, *BARKS))[bands],
            loudness_groups=np.unique(groups).astype(np.float64),
        )


def _smoothing(decimation: int, samplerate: int) -> FloatArray:
    """Return the low-pass as a matrix for one step of the low rate, (decimation + 6, 8).

    Rows stand for the frames of a step and the 6 states before the step. Columns stand for the 6
    states after the step, the output sample and a 0.
    """
    rows = np.zeros((decimation + 6, 8))
    states, frames = np.eye(6, decimation + 6, decimation), np.eye(decimation, decimation + 6)
    sections = np.zeros((0, 6))
    if 0.4 * samplerate / decimation > LOW_TOP_HZ and decimation > 1:
        sections = round_sections(*low_pass(BUTTERWORTH_5, LOW_TOP_HZ, samplerate))
    for sample in frames:  # a loop, since library functions round differently on other machines
        for (b0, b1, b2, _, a1, a2), state in zip(
            sections, states.reshape(-1, 2, decimation + 6), strict=False
        ):
            heard = b0 * sample + state[0]
            state[0] = b1 * sample - a1 * heard + state[1]
            state[1] = b2 * sample - a2 * heard
            sample = heard
    rows[:, :6], rows[:, 6] = states.T, sample
    return rows


def _pole(low: int, low_rate_hz: float) -> tuple[float, float, float]:
    below_hz, above_hz = LOW_EDGES_HZ[low : low + 2]
    radius = math.exp(-math.pi * POLE_WIDTH * (above_hz - below_hz) / low_rate_hz)
    turn = math.pi * (below_hz + above_hz) / low_rate_hz
    return radius * math.cos(turn), radius * math.sin(turn), 1.0 - radius


def _low_weight(low: int) -> float:
    """Return a low band's excitation per mean square. Excitation 1 is the threshold in quiet."""
    over_db = float(OVER_QUIET_DB[LOW_BAND_OF[low]]) + LOW_DB
    if LOW_BAND_OF[low] == 0:
        over_db += float(np.interp(sum(LOW_EDGES_HZ[low : low + 2]) / 2, DEEP_HZ, DEEP_DB))
    return math.pow(10.0, 0.1 * over_db)


def _high_bands(onsets: OnsetDesign, bin_hz: float) -> tuple[list[int], list[int]]:
    """Return edges (bins of the onset window) and numbers of the loudness bands above 560 Hz."""
    edges, bands = [round(LOW_EDGES_HZ[-1] / bin_hz)], list[int]()
    for band in range(LOW_BAND_OF[-1] + 1, len(BANDS_HZ)):
        edge = max(edges[-1] + 1, round(BANDS_HZ[band] / bin_hz))
        if edges[-1] < onsets.short_bins:
            edges.append(min(edge, onsets.short_bins))
            bands.append(band)
    return (edges if bands else []), bands
