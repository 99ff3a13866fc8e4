"""Design of the loudness follower: ISO 532-1, felt strength, the programme's level."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design.synthesis import SynthesisDesign
from audioflinger_hook.transform.parameters import TransformParameters
from audioflinger_hook.transform.spectrum import Spectrum

FULL_SCALE_DB = 94.0
"""Sound pressure level that a full-scale tone stands for; loudness in phon counts from here."""

BANDS_HZ = (
    *(90.0, 180.0, 280.0, 355.0, 450.0, 560.0, 710.0, 900.0, 1_120.0, 1_400.0),
    *(1_800.0, 2_240.0, 2_800.0, 3_550.0, 4_500.0, 5_600.0, 7_100.0, 9_000.0, 11_200.0),
)
"""Upper edges of the 20 bands of ISO 532-1 but the last: thirds of an octave from 280 Hz up."""

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

DEEP_HZ, DEEP_DB = (25.0, 65.0, 90.0), (7.0, -6.0, -6.0)
"""Deep sound is felt more than heard: bins under 90 Hz count so many dB more, by frequency. Where
less, it is as the ear weighs them in ISO 532-1."""

FELT_AT_HZ = 40.0
"""Vibration of this frequency has weight 1. Above 12.5 Hz, the sensitivity of a seated body to
vertical acceleration falls with the inverse of frequency: W_k of ISO 2631-1 without its limit at
100 Hz, and contours of equal comfort (Griffin, Whitham and Parsons, Ergonomics 25, 1982)."""

FELT_FROM_HZ = 30.0
"""Vibration under this counts as if it had this frequency: few actuators reach lower."""

RIG_RATIO_MAX = 2.0
"""A resonance is levelled by 6 dB at most: more under it would be excursion, not vibration."""

PROGRAMME_TOP_DB = -10.0
"""Loudness of the loudest programmes; programmes down to `loudness_db` below it are lifted."""

PROGRAMME_START_DB = -20.0
"""Level of the programme before any sound."""

RELEASE_DB_A_S = 10.0
"""Rate at which loudness falls; it rises at once. With 20 an explosion stands half a dB less above
speech, and level goes less with level (0.63 for 0.67)."""

PROGRAMME_DB_A_S = 0.1
"""The programme's level goes to the loudness by this, so that half of the time is over it ..."""

RISE_S, FALL_S = 240.0, 120.0
"""... and by what is missing, in so many seconds: a crescendo is felt as one."""

JUMP_UP_S, JUMP_DOWN_S = 0.5, 10.0
"""A level that is far above or below the programme for so long is that of another volume. Loud
scenes may be far below for some seconds; too strong a vibration may not last."""

JUMP_UP_DB_A_S, JUMP_DOWN_DB_A_S = 20.0, 2.0
"""Rates at which the programme's level then goes there."""

FLOOR_RISE_DB_A_S = 2.0
"""The noise floor is the least recent loudness: it falls at once and rises at this rate."""


@dataclass(frozen=True, eq=False)
class LoudnessDesign:
    """How vibration follows loudness; levels in dB, rates in dB per hop."""

    programme_start: float
    """Level of the programme before any sound."""
    programme_min: float
    programme_step: float
    """The programme's level moves by this, ..."""
    programme_rise: float
    """... and by this share of what is missing upwards, ..."""
    programme_fall: float
    """... or downwards."""
    jump_up_hops: float
    """Hops after which the programme's level goes fast to one far above, ..."""
    jump_down_hops: float
    """... or far below."""
    jump_up_step: float
    jump_down_step: float
    release: float
    """Rate at which loudness falls."""
    floor_min: float
    """Loudness up to which there is no vibration."""
    floor_rise: float
    """Rate at which the noise floor rises."""
    gate: float
    """Width of the soft gate over the noise floor."""
    target: float
    """Vibration at the programme's level."""
    slope: float
    """Vibration for each dB of loudness."""
    gain_max: float
    """Largest factor on amplitudes."""
    loudness_weights: FloatArray
    """Of each bin's squared magnitude: its share of its band's excitation over the threshold in
    quiet. Empty if loudness is not followed."""
    loudness_edges: FloatArray
    """Bins: the first of each band, and past the last."""
    loudness_scale: FloatArray
    """Of each band: sone per Bark at its threshold."""
    loudness_widths: FloatArray
    """Of each band: Bark."""
    onset_loudness_weights: FloatArray
    """The same four tables for the short windows in which onsets are found."""
    onset_loudness_edges: FloatArray
    onset_loudness_scale: FloatArray
    onset_loudness_widths: FloatArray
    onset_felt_squares: FloatArray
    """Squared sensitivity at the vibration frequency of each short bin."""
    felt_weights: FloatArray
    """Sensitivity by vibration frequency, in steps of `gain_step_hz`."""
    programme_top: float = PROGRAMME_TOP_DB
    far: float = 20.0
    """More than this is not missing: the level rises by 4 dB a second at most and falls by 6."""
    jump: float = 30.0
    """Distance that is far, and ..."""
    near: float = 10.0
    """... one that is near again."""
    floor_under: float = 55.0
    """The noise floor stays this far below the programme's level: a steady sound is no noise."""
    jitter: float = 1.0
    """Smaller changes of loudness from hop to hop are jitter, of which ..."""
    jitter_followed: float = 0.05
    """... this share is followed."""
    onset_under: float = 3.0
    """A sound of 5 ms is heard softer than a long one. An onset does not know which it will be."""
    concentrated: float = 4.0
    """What would be limited takes on the sensitivity of a seated body to this power at most."""
    slope_a_bark: float = 0.45
    """Above a band its specific loudness N' falls by this / N'^0.25 of itself for each Bark: nearly
    what the table of slopes in ISO 532-1 says."""
    gate_margin: float = 0.01
    """Share of the gate's width that is still silent. At the floor itself, where the quietest
    recent hop stands exactly, rounding would decide."""
    nothing: float = 1e-20
    """Energy below which a window counts as -200 dB, to avoid the logarithm of 0."""

    @classmethod
    def of(
        cls,
        parameters: TransformParameters,
        hop_s: float,
        spectrum: Spectrum,
        bins: int,
        onset_bin_hz: float,
        onset_hz: FloatArray,
    ) -> LoudnessDesign:
        """Return the design for hops of this many seconds.

        bins: that are looked at in spectra of long windows. onset_hz: vibration frequencies of the
        bins of short windows, which are onset_bin_hz apart.
        """
        if parameters.loudness_db > 0.0:
            long = loudness_tables(spectrum.bin_hz, bins, tone_spread(spectrum))
            short = loudness_tables(onset_bin_hz, onset_hz.size, 1.0)
        else:
            long = short = (np.zeros(0),) * 4
        steps = np.arange(1.01 * parameters.vibration_top_hz / SynthesisDesign.gain_step_hz)
        programme_min = PROGRAMME_TOP_DB - parameters.loudness_db
        return cls(
            programme_start=max(programme_min, PROGRAMME_START_DB),
            programme_min=programme_min,
            programme_step=PROGRAMME_DB_A_S * hop_s,
            programme_rise=hop_s / RISE_S,
            programme_fall=hop_s / FALL_S,
            jump_up_hops=float(round(JUMP_UP_S / hop_s)),
            jump_down_hops=float(round(JUMP_DOWN_S / hop_s)),
            jump_up_step=JUMP_UP_DB_A_S * hop_s,
            jump_down_step=JUMP_DOWN_DB_A_S * hop_s,
            release=RELEASE_DB_A_S * hop_s,
            floor_min=parameters.loudness_floor_db,
            floor_rise=FLOOR_RISE_DB_A_S * hop_s,
            gate=parameters.loudness_gate_db,
            target=parameters.loudness_target_db,
            slope=parameters.dynamics,
            gain_max=math.pow(10.0, parameters.loudness_db / 20.0),
            loudness_weights=long[0],
            loudness_edges=long[1],
            loudness_scale=long[2],
            loudness_widths=long[3],
            onset_loudness_weights=short[0],
            onset_loudness_edges=short[1],
            onset_loudness_scale=short[2],
            onset_loudness_widths=short[3],
            onset_felt_squares=felt_weight(parameters, onset_hz) ** 2,
            felt_weights=felt_weight(parameters, SynthesisDesign.gain_step_hz * steps),
        )


def felt_weight(parameters: TransformParameters, vibration_hz: FloatArray) -> FloatArray:
    """Return how strongly a seated body feels a drive at frequencies in Hz.

    It is always 1 for strength "flat", and for "felt" the sensitivity to acceleration, 1 at 40 Hz.
    For "rig" it contains the acceleration for each volt of a resonant actuator, 1 far above its
    resonance, as far as `RIG_RATIO_MAX`.
    """
    if parameters.strength == "flat":
        return np.ones_like(vibration_hz)
    hz = np.maximum(vibration_hz, FELT_FROM_HZ)
    felt: FloatArray = FELT_AT_HZ / hz
    if parameters.strength == "rig" and parameters.resonance_hz > 0.0:
        ratio = parameters.resonance_hz / hz
        response = 1.0 / np.hypot(1.0 - ratio**2, ratio / parameters.resonance_q)
        felt *= np.clip(response, 1.0 / RIG_RATIO_MAX, RIG_RATIO_MAX)
    return felt


def loudness_tables(bin_hz: float, bins: int, spread: float) -> tuple[FloatArray, ...]:
    """Return the tables for loudness after ISO 532-1 from a spectrum's first bins.

    spread: the sum of squared magnitudes over the bins of a full-scale tone. Returned are weights
    of the bins, the bands' edges in bins, then for each band the sone per Bark at its threshold,
    and its width in Bark. A band without a bin joins the next.
    """
    over_db = FULL_SCALE_DB - OUTER_EAR_DB - BANDWIDTH_DB - QUIET_DB
    edges, barks, bands = [0], [0.0], []
    for band, (edge_hz, bark) in enumerate(zip((*BANDS_HZ, np.inf), BARKS, strict=True)):
        edge = round(min(edge_hz / bin_hz, bins))
        if edge > edges[-1]:
            edges.append(edge)
            barks.append(bark)
            bands.append(band)
    weights = np.repeat(10.0 ** (0.1 * over_db[bands]), np.diff(edges)) / spread
    hz = bin_hz * np.arange(weights.size)
    deep = hz < BANDS_HZ[0]
    weights[deep] *= 10.0 ** (0.1 * np.interp(hz[deep], DEEP_HZ, DEEP_DB))
    return (
        weights,
        np.array(edges, dtype=np.float64),
        0.0635 * 10.0 ** (0.025 * QUIET_DB[bands]),
        np.diff(barks),
    )


def tone_spread(spectrum: Spectrum) -> float:
    """Return the sum of squared magnitudes over the bins of a full-scale tone, by Parseval."""
    window = spectrum.window
    return float(spectrum.fft_length * (window * window).sum() / window.sum() ** 2)
