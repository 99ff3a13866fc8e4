"""Design of the parts that follow the sound's loudness and detect speech."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.parameters import TransformParameters
from audioflinger_hook.transform.spectrum import Spectrum

FULL_SCALE_DB = 94.0
"""Sound pressure level that a full-scale tone stands for; loudness in phon counts from here."""

BANDS_HZ = (90.0, 180.0, 280.0, 355.0, 450.0, 560.0, 710.0, 900.0, 1_120.0, 1_400.0)
BANDS_HZ += (1_800.0, 2_240.0, 2_800.0, 3_550.0, 4_500.0, 5_600.0, 7_100.0, 9_000.0, 11_200.0)
"""Upper edges of the bands of ISO 532-1, but of the last one: thirds of an octave from 280 Hz up."""

BARKS = (0.9, 1.8, 2.8, 3.5, 4.4, 5.4, 6.6, 7.9, 9.2, 10.6, 12.3, 13.8, 15.2, 16.7, 18.1, 19.3)
BARKS += (20.6, 21.8, 22.7, 23.6)
"""The same edges as critical-band rates, table 3 of ISO 532-1."""

QUIET_DB = np.array((30.0, 18.0, 12.0, 8.0, 7.0, 6.0, 5.0, 4.0) + 12 * (3.0,)) - 15.0
"""Threshold in quiet, band by band, 15 dB under that of ISO 532-1. The listener's volume is not
known: a lower volume should change all loudness alike."""

OUTER_EAR_DB = 10 * (0.0,) + (-0.5, -1.6, -3.2, -5.4, -5.6, -4.0, -1.5, 2.0, 5.0, 12.0)
"""Attenuation by the outer ear."""

BANDWIDTH_DB = (-0.25, -0.6, -0.8, -0.8, -0.5, 0.0, 0.5, 1.1, 1.5, 1.7)
BANDWIDTH_DB += (1.8, 1.8, 1.7, 1.6, 1.4, 1.2, 0.8, 0.5, 0.0, -0.5)
"""From the level in a third of an octave to the level in a critical band."""

DEEP_HZ, DEEP_DB, LOW_DB = 40.0, 5.0, -6.0
"""Deep sound is felt more than heard: bins up to 40 Hz count 5 dB more. Above, up to 90 Hz, bins
count less, as the ear weighs them in ISO 532-1."""

FELT_AT_HZ = 40.0
"""Vibration of this frequency has weight 1. The sensitivity to vertical acceleration of a seat falls
with the inverse of frequency above 12.5 Hz: W_k of ISO 2631-1 without its upper limit of 100 Hz, as
contours of equal comfort do (Griffin, Whitham and Parsons, Ergonomics 25, 1982)."""

FELT_FROM_HZ = 30.0
"""Vibration under this counts as if it had this frequency: few actuators reach lower."""

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

OCTAVES_HZ = (100.0, 200.0, 400.0, 800.0, 1_600.0, 3_200.0, 8_000.0)
"""Edges of the six speech bands; the last band has the hissing sounds."""

PITCH_HZ = 70.0, 320.0
"""Pitches from men with deep voices to children."""
PITCHES = 44
"""Number of combs tried, evenly spaced in logarithm: 3.6 % apart."""
COMB_TOP_HZ, COMB_TEETH = 1_600.0, 10
"""A comb's highest tooth in Hz, and its largest number of teeth."""

MEMORY_S = 0.3
"""Time constant of all averages."""
FAST_S, SLOW_S = 0.02, 0.15
"""A level's swing is the difference of its averages over these times."""
PEAK_DB_A_SECOND = 6.0
"""Rate at which the loudest level is forgotten."""
ATTACK_S, RELEASE_S = 0.1, 0.5
"""Time in which belief in speech goes from 0 to 1, and back."""
REST_S = 1.5
"""After this much silence everything is forgotten."""
VOICE_LEARNT_S = 0.15
"""Time constant of learning the level of the voice, octave by octave."""
VOICE_DB_A_SECOND = 6.0
"""Rate at which the level of the voice is forgotten."""
BACKGROUND_S, BACKGROUND_DB_A_SECOND = 0.05, 8.0
"""An octave's background falls in this time constant, and rises at this rate."""

RAMPS: dict[str, tuple[float, float]] = {
    "voiced": (0.10, 0.30),
    "quiet_db": (-30.0, -15.0),
    "voicing": (0.12, 0.30),
    "swing_db": (2.5, 4.5),
    "balance_db": (2.2, 3.4),
    "resting": (0.5, 0.8),
    "spared_hz": (80.0, 120.0),
    "excess_db": (3.0, 9.0),
    "background_db": (2.0, 8.0),
    "between": (0.25, 0.40),
}
"""Where each measure begins to count, and where it counts in full; between them on a line, so that
rounding decides nothing. In the order in which native/speech.c takes them.

voiced: the best comb's contrast. quiet_db: level against the loudest; quieter hops are no
evidence. voicing: average of the first. swing_db, balance_db: root mean squares. resting: share of
the voiced hops with a pitch at rest, which speaks against speech. spared_hz: partials under it are
not lowered. excess_db: of an octave over the voice's level. background_db: of an octave over its
background. between: distance from the nearest harmonic, in pitches.
"""


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
    onset_under: float = 2.0
    """A sound of 5 ms is heard softer than a long one. An onset does not know which it will be."""
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
        followed = parameters.loudness_db > 0.0
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
            felt_weights=felt_weights(parameters),
            onset_felt_squares=felt_weight(onset_hz) ** 2
            if parameters.strength == "felt"
            else np.ones_like(onset_hz),
            **_named("loudness", spectrum.bin_hz, bins if followed else 0, tone_spread(spectrum)),
            **_named("onset_loudness", onset_bin_hz, onset_hz.size if followed else 0, 1.0),
        )


@dataclass(frozen=True, eq=False)
class SpeechDesign:
    """How speech is detected and lowered. A share is what an average takes on in one hop."""

    speech_db: float
    """Reduction of speech; 0 for off."""
    speech_average: float
    speech_fast: float
    speech_slow: float
    speech_learnt: float
    speech_background_fall: float
    speech_background_rise_db: float
    speech_voice_fall_db: float
    speech_peak_fall: float
    """Factor on the loudest power, each hop."""
    speech_attack: float
    speech_release: float
    speech_rest_hops: float
    speech_edges: FloatArray
    """Bins: the first of each octave, and past the last."""
    speech_centres_hz: FloatArray
    """Centres of the octaves."""
    speech_log_pitches: FloatArray
    speech_teeth: FloatArray
    """Bins, 0 for unused: of all combs on harmonics, then between them, (2, pitches x teeth)."""
    speech_quiet_share: float = 0.3
    """Quiet hops tell nothing of pitch, and count this share where swings are averaged: else a
    pause would be enough to forget who spoke."""
    speech_swing_max_db: float = 12.0
    """Swings are limited to this, so that a start of sound counts only briefly as a syllable."""
    speech_silent_power: float = 1e-9
    """All levels are in dB above this power, 50 dB under that of the weakest tone that can be
    principal in silence."""
    speech_unheard: float = 1e-5
    """An octave's level stays above this share of the loudest power."""
    speech_even: float = 1e-14
    """Share of the highest power that every bin has at least: less is rounding beside a line."""
    speech_equal: float = 1e-9
    """Combs this near to the best count as equal; the lowest of them is used."""
    speech_flat: float = 1e-6
    """The three combs around the best are curved at least by this."""
    speech_steady_pitch: float = 0.004
    """A pitch rests if its logarithm changes by less than this per hop: a 15th of a semitone."""
    speech_likely: float = 0.5
    """Belief rises where the four cues say more than this, ..."""
    speech_likely_still: float = 0.25
    """... or than this once there is belief, ..."""
    speech_sure: float = 0.15
    """... at full speed where they say so by this."""
    speech_clear_db: float = 12.0
    """A voice may be louder than before by this while its pitch is clear."""
    speech_apart: float = 0.01
    """Share of its distance by which each further harmonic may be off a multiple of the pitch."""
    speech_ramps: FloatArray = field(default_factory=lambda: np.array(list(RAMPS.values())))

    @classmethod
    def of(cls, suppression_db: float, bin_hz: float, bins: int, hop_s: float) -> SpeechDesign:
        """Return the design for spectra with this many bins, one spectrum per hop."""
        octaves_hz = np.array(OCTAVES_HZ)
        edges = [min(bins, max(1, round(hz / bin_hz))) for hz in OCTAVES_HZ]
        log_pitches = np.linspace(math.log(PITCH_HZ[0]), math.log(PITCH_HZ[1]), PITCHES)
        return cls(
            speech_db=suppression_db,
            speech_average=_share(hop_s, MEMORY_S),
            speech_fast=_share(hop_s, FAST_S),
            speech_slow=_share(hop_s, SLOW_S),
            speech_learnt=_share(hop_s, VOICE_LEARNT_S),
            speech_background_fall=_share(hop_s, BACKGROUND_S),
            speech_background_rise_db=hop_s * BACKGROUND_DB_A_SECOND,
            speech_voice_fall_db=hop_s * VOICE_DB_A_SECOND,
            speech_peak_fall=10.0 ** (-hop_s * PEAK_DB_A_SECOND / 10.0),
            speech_attack=hop_s / ATTACK_S,
            speech_release=hop_s / RELEASE_S,
            speech_rest_hops=float(math.ceil(REST_S / hop_s)),
            speech_edges=np.array(edges, dtype=np.float64),
            speech_centres_hz=np.sqrt(octaves_hz[:-1] * octaves_hz[1:]),
            speech_log_pitches=log_pitches,
            speech_teeth=_teeth(np.exp(log_pitches), bin_hz, bins),
        )


def felt_weight(vibration_hz: FloatArray) -> FloatArray:
    """Return how strongly a seated body feels acceleration at frequencies in Hz, 1 at 40 Hz."""
    return FELT_AT_HZ / np.maximum(vibration_hz, FELT_FROM_HZ)


def felt_weights(parameters: TransformParameters) -> FloatArray:
    """Return `felt_weight` in steps of 0.25 Hz up to the top; all 1 for strength "flat"."""
    hz = np.arange(0.0, 1.01 * parameters.vibration_top_hz, 0.25)
    return felt_weight(hz) if parameters.strength == "felt" else np.ones_like(hz)


def loudness_tables(bin_hz: float, bins: int, spread: float) -> tuple[FloatArray, ...]:
    """Return the tables for loudness after ISO 532-1 from a spectrum's first bins.

    spread: the sum of squared magnitudes over the bins of a full-scale tone. Returned are weights
    of the bins, the bands' edges in bins, then for each band the sone per Bark at its threshold,
    and its width in Bark. A band without a bin joins the next.
    """
    if not bins:
        return tuple(np.zeros((4, 0)))
    over_db = FULL_SCALE_DB - np.array(OUTER_EAR_DB) - np.array(BANDWIDTH_DB) - QUIET_DB
    edges, barks, bands = [0], [0.0], []
    for band, (hz, bark) in enumerate(zip((*BANDS_HZ, np.inf), BARKS, strict=True)):
        edge = int(min(bins, round(min(hz / bin_hz, bins))))
        if edge > edges[-1]:
            edges.append(edge)
            barks.append(bark)
            bands.append(band)
    weights = np.repeat(10.0 ** (0.1 * over_db[bands]), np.diff(edges)) / spread
    hz = bin_hz * np.arange(weights.size)
    weights[hz < DEEP_HZ] *= 10.0 ** (0.1 * DEEP_DB)
    weights[(hz >= DEEP_HZ) & (hz < BANDS_HZ[0])] *= 10.0 ** (0.1 * LOW_DB)
    return (
        weights,
        np.array(edges, dtype=np.float64),
        0.0635 * 10.0 ** (0.025 * QUIET_DB[bands]),
        np.diff(barks),
    )


def _named(prefix: str, bin_hz: float, bins: int, spread: float) -> dict[str, FloatArray]:
    names = ("weights", "edges", "scale", "widths")
    tables = loudness_tables(bin_hz, bins, spread)
    return {f"{prefix}_{name}": table for name, table in zip(names, tables, strict=True)}


def tone_spread(spectrum: Spectrum) -> float:
    """Return the sum of squared magnitudes over the bins of a full-scale tone, by Parseval."""
    window = spectrum.window
    return float(spectrum.fft_length * (window * window).sum() / window.sum() ** 2)


def _teeth(pitches_hz: FloatArray, bin_hz: float, bins: int) -> FloatArray:
    """Return where combs have teeth, and where none, in bins: (2, pitches x teeth)."""
    on = pitches_hz[:, None] * np.arange(1, COMB_TEETH + 1)
    between = on - 0.5 * pitches_hz[:, None]
    used = on <= min(COMB_TOP_HZ, (bins - 2) * bin_hz)
    teeth = np.stack((np.where(used, on, 0.0), np.where(used, between, 0.0))) / bin_hz
    return teeth.reshape(2, -1)


def _share(hop_s: float, time_s: float) -> float:
    """Return the share of a difference that an average over a time takes on in a hop."""
    return 1.0 - math.exp(-hop_s / time_s)
