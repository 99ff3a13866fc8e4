"""Constants and tables of the detection and attenuation of speech."""

import math
from dataclasses import dataclass, field

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray

OCTAVES_HZ = (100.0, 200.0, 400.0, 800.0, 1_600.0, 3_200.0, 8_000.0)
"""Edges of the six speech bands. The last band contains the fricative consonants."""

PITCH_HZ = 70.0, 320.0  # lowest and highest pitch of voices
PITCHES = 44  # number of candidate pitches, 3.6 % apart; each is tested by a comb of harmonics
COMB_TOP_HZ, COMB_TEETH = 1_600.0, 10  # highest frequency and largest number of harmonics of a comb

MEMORY_S = 0.3  # time constant of the averages of voicing, pitch steadiness and modulation
FAST_S, SLOW_S = 0.02, 0.15  # modulation: difference of a level's averages over these times
PEAK_DB_A_SECOND = 6.0  # decay rate of the recent maximum of the total power
ATTACK_S, RELEASE_S = 0.1, 0.5  # shortest rise and fall time of the probability of speech
REST_S = 1.5  # silence of this duration resets the speech detection
VOICE_LEARNT_S = 0.15  # time constant of a rise of the voice's level in each band
VOICE_DB_A_SECOND = 6.0  # decay rate of the voice's level in each band
BACKGROUND_S = 0.05  # time constant of a fall of the background's level in each band
BACKGROUND_DB_A_SECOND = 8.0  # rate of a rise of the background's level in each band

# A linear ramp maps each measure to a number from 0 (at the first value) to 1 (at the second).
# native/speech.c uses the same order.
RAMPS: dict[str, tuple[float, float]] = {
    "voiced": (0.10, 0.30),  # contrast of the best comb
    "quiet_db": (-30.0, -15.0),  # total level relative to the recent maximum
    "voicing": (0.12, 0.30),  # average of `voiced`
    "swing_db": (2.5, 4.5),  # RMS modulation of the level of vowels
    "balance_db": (2.2, 3.4),  # RMS modulation of bands relative to their mean
    "resting": (0.5, 0.8),  # share of voiced hops with a constant pitch, a sign of music
    "spared_hz": (80.0, 120.0),  # audio frequency of a partial; low partials are not attenuated
    "excess_db": (3.0, 9.0),  # a band's level relative to the voice's level in this band
    "background_db": (2.0, 8.0),  # a band's level relative to the background's level in this band
    "between": (0.25, 0.40),  # distance from the nearest harmonic, in multiples of the pitch
}


@dataclass(frozen=True, eq=False)
class SpeechDesign:
    """Constants of speech detection and attenuation. Rates and weights apply to one hop."""

    speech_db: float  # attenuation of the vibration of speech in dB; 0 for off
    speech_average: float
    speech_fast: float
    speech_slow: float
    speech_learnt: float
    speech_background_fall: float
    speech_background_rise_db: float
    speech_voice_fall_db: float
    speech_peak_fall: float  # factor on the recent maximum of the total power
    speech_attack: float
    speech_release: float
    speech_rest_hops: float
    speech_edges: FloatArray  # first bin of each band, then the end of the last band
    speech_centres_hz: FloatArray  # centres of the bands
    speech_log_pitches: FloatArray
    speech_teeth: FloatArray  # see `_teeth`
    speech_quiet_share: float = 0.3  # relative weight of a quiet hop in averages of modulation
    speech_swing_max_db: float = 12.0  # largest modulation of one band
    speech_silent_power: float = 1e-9  # reference power of all levels in dB
    speech_unheard: float = 1e-5  # floor of a band's power, relative to the recent maximum
    speech_even: float = 1e-14  # added to each bin's power, as a share of the highest bin's power
    speech_equal: float = 1e-9  # contrasts of combs that differ by less count as equal
    speech_flat: float = 1e-6  # least curvature for the interpolation of the best comb's pitch
    speech_steady_pitch: float = 0.004  # largest change of a constant log pitch per hop
    # The probability of speech rises while the product of four measures exceeds a threshold. The
    # threshold is speech_likely at probability 0 and speech_likely_still at probability 1. The rate
    # of change is proportional to the excess, up to speech_sure.
    speech_likely: float = 0.5
    speech_likely_still: float = 0.25
    speech_sure: float = 0.15
    speech_clear_db: float = 12.0  # with a clear pitch, a band may exceed the voice's level by this
    speech_apart: float = 0.01  # tolerance of a harmonic's frequency, as a share of the frequency
    speech_ramps: FloatArray = field(default_factory=lambda: np.array(list(RAMPS.values())))

    @classmethod
    def of(cls, suppression_db: float, bin_hz: float, bins: int, hop_s: float) -> "SpeechDesign":
        """Return the design for spectra with `bins` bins, one spectrum per hop."""
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
    """Return, in bins, each pitch's harmonics, and each harmonic minus half the pitch.

    The shape is (2, pitches x `COMB_TEETH`). Unused entries are 0.
    """
    on = pitches_hz[:, None] * np.arange(1, COMB_TEETH + 1)
    between = on - 0.5 * pitches_hz[:, None]
    used = on <= min(COMB_TOP_HZ, (bins - 2) * bin_hz)
    teeth = np.stack((np.where(used, on, 0.0), np.where(used, between, 0.0))) / bin_hz
    return teeth.reshape(2, -1)


def _share(hop_s: float, time_s: float) -> float:
    """Return the weight of a new value in an exponential average with time constant `time_s`."""
    return 1.0 - math.exp(-hop_s / time_s)
