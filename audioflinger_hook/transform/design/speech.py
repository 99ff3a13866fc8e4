"""Design of speech detection: how speech is known in the sound, and how it is lowered."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray

OCTAVES_HZ = (100.0, 200.0, 400.0, 800.0, 1_600.0, 3_200.0, 8_000.0)
"""Edges of the six speech bands; the last band has the hissing sounds."""

PITCH_HZ = 70.0, 320.0  # pitches from men with deep voices to children
PITCHES = 44  # number of combs tried, evenly spaced in logarithm: 3.6 % apart
COMB_TOP_HZ, COMB_TEETH = 1_600.0, 10  # a comb's highest tooth, and its largest number of teeth

MEMORY_S = 0.3  # time constant of all averages
FAST_S, SLOW_S = 0.02, 0.15  # a level's swing is the difference of its averages over these times
PEAK_DB_A_SECOND = 6.0  # rate at which the loudest level is forgotten
ATTACK_S, RELEASE_S = 0.1, 0.5  # time in which belief in speech goes from 0 to 1, and back
REST_S = 1.5  # after this much silence everything is forgotten
VOICE_LEARNT_S = 0.15  # time constant of learning the level of the voice, octave by octave
VOICE_DB_A_SECOND = 6.0  # rate at which the level of the voice is forgotten
BACKGROUND_S, BACKGROUND_DB_A_SECOND = 0.05, 8.0  # an octave's: time constant of fall, rise

# Where each measure begins to count, and where it counts in full; between them on a line, so that
# rounding decides nothing. In the order in which native/speech.c takes them.
RAMPS: dict[str, tuple[float, float]] = {
    "voiced": (0.10, 0.30),  # the best comb's contrast
    "quiet_db": (-30.0, -15.0),  # level against the loudest; quieter hops are no evidence
    "voicing": (0.12, 0.30),  # average of `voiced`
    "swing_db": (2.5, 4.5),  # root mean square
    "balance_db": (2.2, 3.4),  # root mean square
    "resting": (0.5, 0.8),  # share of the voiced hops with a resting pitch, against speech
    "spared_hz": (80.0, 120.0),  # lower partials are not lowered
    "excess_db": (3.0, 9.0),  # of an octave over the voice's level
    "background_db": (2.0, 8.0),  # of an octave over its background
    "between": (0.25, 0.40),  # distance from the nearest harmonic, in pitches
}


@dataclass(frozen=True, eq=False)
class SpeechDesign:
    """How speech is detected and lowered. A share is what an average takes on in one hop."""

    speech_db: float  # reduction of speech; 0 for off
    speech_average: float
    speech_fast: float
    speech_slow: float
    speech_learnt: float
    speech_background_fall: float
    speech_background_rise_db: float
    speech_voice_fall_db: float
    speech_peak_fall: float  # factor on the loudest power, each hop
    speech_attack: float
    speech_release: float
    speech_rest_hops: float
    speech_edges: FloatArray  # bins: the first of each octave, and past the last
    speech_centres_hz: FloatArray  # centres of the octaves
    speech_log_pitches: FloatArray
    speech_teeth: FloatArray  # see `_teeth`
    # Quiet hops tell nothing of pitch, and count this share where swings are averaged: else a
    # pause would be enough to forget who spoke.
    speech_quiet_share: float = 0.3
    # Swings are limited to this, so that a start of sound counts only briefly as a syllable.
    speech_swing_max_db: float = 12.0
    # All levels are in dB above this power, 50 dB under that of the weakest tone that can be
    # principal in silence.
    speech_silent_power: float = 1e-9
    speech_unheard: float = 1e-5  # an octave's level stays above this share of the loudest power
    speech_even: float = 1e-14  # least share of the highest power in a bin: less is rounding
    speech_equal: float = 1e-9  # combs this near to the best are equal; the lowest of them is used
    speech_flat: float = 1e-6  # the three combs around the best are curved at least by this
    # A pitch rests if its logarithm changes by less than this per hop: a 15th of a semitone.
    speech_steady_pitch: float = 0.004
    # Belief rises where the four cues say more than the first number, or than the second once there
    # is belief; at full speed where they exceed it by the third.
    speech_likely: float = 0.5
    speech_likely_still: float = 0.25
    speech_sure: float = 0.15
    speech_clear_db: float = 12.0  # a voice may get louder by this while its pitch is clear
    # Share of its distance by which each further harmonic may be off a multiple of the pitch.
    speech_apart: float = 0.01
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


def _teeth(pitches_hz: FloatArray, bin_hz: float, bins: int) -> FloatArray:
    """Return the bins of all combs on harmonics, then between: (2, pitches x teeth), 0: unused."""
    on = pitches_hz[:, None] * np.arange(1, COMB_TEETH + 1)
    between = on - 0.5 * pitches_hz[:, None]
    used = on <= min(COMB_TOP_HZ, (bins - 2) * bin_hz)
    teeth = np.stack((np.where(used, on, 0.0), np.where(used, between, 0.0))) / bin_hz
    return teeth.reshape(2, -1)


def _share(hop_s: float, time_s: float) -> float:
    """Return the share of a difference that an average over a time takes on in a hop."""
    return 1.0 - math.exp(-hop_s / time_s)
