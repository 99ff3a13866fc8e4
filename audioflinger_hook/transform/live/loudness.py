"""The loudness follower: how strong a hop vibrates by how loud it is heard in its programme.

    loudness of the hop --+--> over the programme's level: 5.5 dB of vibration for 20 phon
                          |        (programme's level: slow, so that the volume does not count)
                          '--> over the noise floor: a soft gate

Persons who match the strength of a seat's vibration to the loudness of a tone turn it up by 5 to
6 dB for 20 phon (Altinsoy and Merchel, "Cross-Modality Matching of Loudness and Perceived Intensity
of Whole-Body Vibrations", HAID 2010). A phon is taken for a dB of K-weighted level. What is louder
is turned down to that at once, what is quieter is turned up again by 7 dB a second at most: so a
rhythm stays one, and no tail swells. The programme's level moves by 2 dB a second, and faster
where it is far off, so that the volume counts no more after some seconds; the vibration follows
that by at most 1.7 dB a second.

How loud a window is heard: its energy weighed as ITU-R BS.1770 weighs it, over the bins."""

from __future__ import annotations

import math

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.parameters import TransformParameters
from audioflinger_hook.transform.spectrum import ComplexArray, Spectrum

PROGRAMME_TOP_DB = -10.0
"""Loudness of the loudest programmes; `loudness_db` under it the quietest that are lifted."""

PROGRAMME_START_DB = -20.0
"""What a programme's level is taken for before anything of it is heard."""

RELEASE_DB_A_S = 10.0
"""How fast what was loud is forgotten: loudness is followed up at once, and down by this. With 20
an explosion stands half a dB less above speech, and level goes less with level (0.63 for 0.67)."""

PROGRAMME_DB_A_S = 2.0
"""The programme's level goes to the loudness by this, so that half of the time is over it ..."""

RISE_S, FALL_S = 10.0, 5.0
"""... and by what is missing, in so many seconds: after 20 dB less it is 4 dB off in 4 s."""

FAR_DB = 20.0
"""More than this is not missing: the level rises by 4 dB a second at most and falls by 6."""

FLOOR_RISE_DB_A_S = 2.0
"""The noise floor is the least loudness of late: it falls at once and rises by this."""

FLOOR_UNDER_PROGRAMME_DB = 30.0
"""The noise floor stays so far under the programme's level: a steady sound is no noise."""

GATE_MARGIN = 0.01
"""Share of the gate's width, from the noise floor on, that is still silent. At the floor itself,
where the quietest hop of late stands exactly, rounding would decide."""

PHONS_A_SLOPE = 20.0


class LoudnessFollower:
    """The follower of one voice: a loudness each hop in, the strength of its vibration out.

    Time is counted in hops. Silence leaves the programme's level as it is. `gain` is the factor
    on the amplitudes of the last hop. Held by one thread at a time.
    """

    def __init__(self, parameters: TransformParameters, hop_s: float) -> None:
        lift_db = parameters.loudness_db
        self.floor_min_db = parameters.loudness_floor_db
        self.target_db = parameters.loudness_target_db
        self.gate_db = parameters.loudness_gate_db
        self.slope = parameters.loudness_slope_db / PHONS_A_SLOPE
        self.gain_max = _ratio(lift_db)
        self.programme_min_db = PROGRAMME_TOP_DB - lift_db
        self.start_db = max(self.programme_min_db, PROGRAMME_START_DB)
        self.release_db = RELEASE_DB_A_S * hop_s
        self.programme_step_db = PROGRAMME_DB_A_S * hop_s
        self.rise = hop_s / RISE_S
        self.fall = hop_s / FALL_S
        self.floor_rise_db = FLOOR_RISE_DB_A_S * hop_s
        self.reset()

    def reset(self) -> None:
        """Return to what is taken for granted before a stream."""
        self.programme_db = self.start_db
        self.floor_db = self.floor_min_db
        self.loud_db = self.floor_min_db
        self.gain = 1.0

    def rest(self) -> None:
        """Take note of a hop without any sound: there is no noise, and nothing was loud."""
        self.floor_db = self.floor_min_db
        self.loud_db = self.floor_min_db

    def strength(self, loudness_db: float) -> float:
        """Return how strong the next hop vibrates, the root of its partials' sum of squares.

        0: the soft gate is closed. Then follow floor and programme.
        """
        floor_db = min(self.floor_db + self.floor_rise_db, loudness_db)
        self.floor_db = max(self.floor_min_db, floor_db)
        self.loud_db = max(self.floor_min_db, self.loud_db - self.release_db, loudness_db)
        gate = self._gate(loudness_db)
        if not gate:
            return 0.0
        above_db = self.loud_db - self.programme_db
        missing_db = max(-FAR_DB, min(FAR_DB, above_db))
        faster = missing_db * (self.rise if missing_db > 0.0 else self.fall)
        # Continuous where the loudness is the programme's, as it is of what is steady.
        towards = max(-1.0, min(1.0, above_db))
        moved_db = self.programme_db + gate * (towards * self.programme_step_db + faster)
        self.programme_db = max(self.programme_min_db, min(PROGRAMME_TOP_DB, moved_db))
        return gate * self._felt(above_db, loudness_db - self.loud_db)

    def onset_gain(self, level: float) -> float:
        """Return the factor on the amplitudes of what begins with this level, a tone's amplitude.

        Nothing is followed by it: the next hop will tell how loud it is.
        """
        if level <= 0.0:
            return 0.0
        loudness_db = 20.0 * math.log10(level)
        loud_db = max(self.loud_db, loudness_db)
        felt = self._felt(loud_db - self.programme_db, loudness_db - loud_db)
        return min(self.gain_max, self._gate(loudness_db) * felt / level)

    def _gate(self, loudness_db: float) -> float:
        """Return how far the soft gate is open, 0 to 1."""
        under_programme_db = self.programme_db - FLOOR_UNDER_PROGRAMME_DB
        gate_from_db = max(self.floor_min_db, min(self.floor_db, under_programme_db))
        over = min(1.0, (loudness_db - gate_from_db) / self.gate_db)
        return over * over * (3.0 - 2.0 * over) if over >= GATE_MARGIN else 0.0

    def _felt(self, above_db: float, turned_down_db: float) -> float:
        """Return the strength of what is so far over the programme, and so far turned down."""
        return _ratio(self.target_db + self.slope * above_db + turned_down_db)

    def gain_for(self, strength: float, power: float) -> float:
        """Return, and keep, the factor that gives amplitudes their strength.

        power: the sum of their squares, above 0.
        """
        self.gain = min(self.gain_max, strength / power**0.5)
        return self.gain


def _ratio(level_db: float) -> float:
    """Return the ratio of amplitudes of a level in dB."""
    return math.pow(10.0, level_db / 20.0)


SHELF_HZ, SHELF_Q, SHELF_DB, SHELF_MIDDLE = 1681.974450955533, 0.7071752369554196, 4.0, 0.4996667741
HIGH_PASS_HZ, HIGH_PASS_Q = 38.13547087602444, 0.5003270373238773
"""The analogue filters whose digital form at 48 kHz is what BS.1770-4 prints (K-weighting)."""

LEVEL_AT_HZ = 1_000.0
"""A full-scale tone of this frequency has a loudness of 0 dB here: 3.01 dB over its LKFS."""

NOTHING = 1e-20
"""Energy under which a window counts as -200 dB: no logarithm of 0."""


def k_weight(audio_hz: FloatArray) -> FloatArray:
    """Return the factor of K-weighting on energy at frequencies in Hz, 1 at 1 kHz, any shape.

    Magnitudes of the analogue filters: the same at every samplerate.
    """
    return _weight(audio_hz) / _weight(np.array(LEVEL_AT_HZ))


def _weight(audio_hz: FloatArray) -> FloatArray:
    s = 1j * audio_hz / SHELF_HZ
    high = 10.0 ** (SHELF_DB / 20.0)
    shelf = (high * s * s + high**SHELF_MIDDLE * s / SHELF_Q + 1.0) / (s * s + s / SHELF_Q + 1.0)
    s = 1j * audio_hz / HIGH_PASS_HZ
    high_pass = s * s / (s * s + s / HIGH_PASS_Q + 1.0)
    weight: FloatArray = np.abs(shelf * high_pass) ** 2
    return weight


def bin_weights(spectrum: Spectrum, bins: int) -> FloatArray:
    """Return what the squared magnitude of each of the first bins counts, (bins,).

    The sum over a tone's bins is its squared amplitude, times `k_weight`.
    """
    window = spectrum._window
    # By Parseval: what a tone's energy is spread over, in bins.
    spread = spectrum.fft_length * float((window * window).sum()) / float(window.sum()) ** 2
    bin_hz = spectrum.bin_hz * np.arange(bins, dtype=np.float64)
    weights: FloatArray = k_weight(bin_hz) / spread
    return weights


def loudness_db(spectra: ComplexArray, weights: FloatArray) -> list[float]:
    """Return the loudness of each row of (rows, columns) in dB, a full-scale tone of 1 kHz at 0.

    Row by row, so that no row's sum depends on its company.
    """
    looked_at = spectra[:, : weights.size]
    return [
        10.0 * math.log10(max(NOTHING, float(np.add.reduce(weights * (x.real**2 + x.imag**2)))))
        for x in looked_at
    ]
