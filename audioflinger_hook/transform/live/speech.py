"""Speech heard in the sound, and what is left of each partial while it is.

Speech is told by what its spectrum looks like and how that moves, from hop to hop:

- voicing: a comb of harmonics of a pitch between 70 and 320 Hz stands out of the valleys between;
- swing: the level rises and falls at the rate of syllables, some 2 to 8 Hz;
- balance: so do the octaves against one another, as vowels and consonants take turns;
- pitch: it moves all the time, where notes and alarms rest on theirs.

The first is spectral, the others are what modulation adds: they tell speech from music (E. Scheirer
and M. Slaney, "Construction and evaluation of a robust multifeature speech/music discriminator",
ICASSP 1997). All four must hold. They are averages over 0.3 s, so speech is known that much late;
the vibration waits for nothing.

What is lowered is not the hop but each partial by what of it can be the speech's: nothing under
80 Hz, nothing that lies between the harmonics of a clear pitch, nothing in an octave that is no
louder than its own background or far louder than the voice has been, and nothing of a hop without
pitch in which any octave is louder than that: so an explosion is felt while somebody speaks.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, IntArray
from audioflinger_hook.transform.spectrum import ComplexArray

OCTAVES_HZ = (100.0, 200.0, 400.0, 800.0, 1_600.0, 3_200.0, 8_000.0)
"""Edges of the six bands that are followed; the last holds what hisses."""
OCTAVES = len(OCTAVES_HZ) - 1
VOWELS = slice(1, 5)
"""Of these the level is taken whose swing is that of the syllables."""

PITCH_HZ = 70.0, 320.0
"""Of men with deep voices to children."""
PITCHES = 44
"""Combs that are tried, evenly spaced in a logarithm: 3.6 % apart."""
COMB_TOP_HZ, COMB_TEETH = 1_600.0, 10
"""A comb's highest tooth, and how many it has at most."""
COMB_POWER = 0.2
"""Combs add up powers of this exponent: many weak harmonics count, one loud tone does not."""
EVEN = 1e-14
"""Share of the highest power that every bin has at least: what is beside a line is rounding."""
EQUAL = 1e-9
"""Combs this near to the best are equals, of which the lowest is taken."""
FLAT = 1e-6
"""The three combs around the best are curved at least by this."""
STEADY_PITCH = 0.004
"""Change of the pitch's logarithm in a hop, well under which it rests: a 15th of a semitone."""

MEMORY_S = 0.3
"""Time constant of all averages."""
FAST_S, SLOW_S = 0.02, 0.15
"""A level's swing is what its average over one of these times differs from that over the other."""
QUIET_SHARE = 0.3
"""Quiet hops tell nothing of pitch, and count this share where swings are averaged: else a pause
would be enough to forget who spoke."""
SWING_MAX_DB = 12.0
"""Swings count up to here: a sound that starts is not taken for a syllable for long."""
PEAK_DB_A_SECOND = 6.0
"""What was loudest is forgotten at this rate."""
SILENT_POWER = 1e-9
"""All levels are counted in dB above this power, 50 dB under that of the weakest tone that can be
principal where nothing else is heard."""
UNHEARD = 1e-5
"""Share of the loudest power under which no octave's level falls."""

ATTACK_S, RELEASE_S = 0.1, 0.5
"""Time in which belief in speech goes from 0 to 1, and back."""
LIKELY, LIKELY_STILL, SURE = 0.5, 0.25, 0.15
"""Belief rises where the four cues say more than the first of these, once there is belief more than
the second; at full speed where they say so by the third."""
REST_S = 1.5
"""After so much silence all is forgotten."""

VOICE_LEARNT_S = 0.15
"""Time constant in which the loudness of the voice is learnt, octave by octave."""
VOICE_DB_A_SECOND = 6.0
"""Rate at which it is forgotten."""
CLEAR_DB = 12.0
"""By so much more a voice may be louder than it has been while its pitch is clear."""
BACKGROUND_S, BACKGROUND_DB_A_SECOND = 0.05, 8.0
"""An octave's background falls in this time constant, and rises at this rate."""
APART_A_HARMONIC = 0.01
"""Share of its distance by which each further harmonic may be off a multiple of the pitch."""

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

voiced: the best comb's contrast. quiet_db: level against what was loudest; quieter hops are no
evidence. voicing: average of the first. swing_db, balance_db: root mean squares. resting: share of
the voiced hops with a pitch at rest, which speaks against speech. spared_hz: partials under it are
not lowered. excess_db: of an octave over the voice's loudness. background_db: of an octave over its
background. between: distance from the nearest harmonic, in pitches.
"""


class SpeechSuppressor:
    """Follows one channel's spectra, one a hop, and says what is left of its partials.

    suppression_db: by how much speech is lowered, over 0 dB. bin_hz, bins: the grid of the spectra.
    hop_s: seconds from one to the next. `belief` is how sure it is of speech, 0 to 1. Held by one
    thread at a time; the numbers depend on the sequence of hops alone.
    """

    def __init__(self, suppression_db: float, bin_hz: float, bins: int, hop_s: float) -> None:
        self._suppression_db = suppression_db
        self._edges = [min(bins, max(1, round(hz / bin_hz))) for hz in OCTAVES_HZ]
        edges = np.array(OCTAVES_HZ)
        self._centres_hz = np.sqrt(edges[:-1] * edges[1:])
        self._log_pitches = np.linspace(math.log(PITCH_HZ[0]), math.log(PITCH_HZ[1]), PITCHES)
        self._teeth = _teeth(np.exp(self._log_pitches), bin_hz, bins)
        self._below: IntArray = self._teeth.astype(np.intp)
        self._beyond = self._teeth - self._below
        self._used = self._teeth > 0.0
        self._comb_bins = int(self._below.max()) + 2
        self._average = _share(hop_s, MEMORY_S)
        self._fast_share, self._slow_share = _share(hop_s, FAST_S), _share(hop_s, SLOW_S)
        self._learnt = _share(hop_s, VOICE_LEARNT_S)
        self._background_fall = _share(hop_s, BACKGROUND_S)
        self._background_rise_db = hop_s * BACKGROUND_DB_A_SECOND
        self._voice_fall_db = hop_s * VOICE_DB_A_SECOND
        self._peak_fall = 10.0 ** (-hop_s * PEAK_DB_A_SECOND / 10.0)
        self._attack, self._release = hop_s / ATTACK_S, hop_s / RELEASE_S
        self._rest_hops = math.ceil(REST_S / hop_s)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.belief = 0.0
        self._hops_to_rest = 0
        self._voiced = self._voicing = self._steady = 0.0
        self._log_pitch = 0.0
        self._swing = self._balance = 0.0
        self._peak = 0.0
        # Levels of the octaves but the first, then that of the vowels.
        self._fast, self._slow = np.zeros(OCTAVES), np.zeros(OCTAVES)
        self._level, self._voice, self._background = np.zeros((3, OCTAVES))

    @property
    def at_rest(self) -> bool:
        """Whether nothing is remembered of what was heard."""
        return not self._hops_to_rest

    def hear(self, spectrum: ComplexArray) -> None:
        """Take the next hop's spectrum, (bins or more,)."""
        power = spectrum.real**2 + spectrum.imag**2
        edges = self._edges
        octaves = np.array([power[edges[one] : edges[one + 1]].sum() for one in range(OCTAVES)])
        comb = power[: self._comb_bins]
        roots = (comb + EVEN * comb.max()) ** COMB_POWER
        here = roots.take(self._below)
        teeth = here + self._beyond * (roots.take(self._below + 1) - here)
        on, between = np.where(self._used, teeth, 0.0).sum(axis=2)
        contrast = (on - between) / (on + between + SILENT_POWER)
        best = int((contrast >= contrast.max() - EQUAL).argmax())
        log_pitch = float(self._log_pitches[best])
        if 0 < best < PITCHES - 1:
            below, top, above = contrast[best - 1 : best + 2]
            offset = (below - above) / (2.0 * min(below - 2.0 * top + above, -FLAT))
            step = self._log_pitches[1] - self._log_pitches[0]
            log_pitch += float(min(0.5, max(-0.5, offset)) * step)
        self._voiced = _ramp(float(contrast[best]), "voiced")
        starts = self.at_rest
        self._hops_to_rest = self._rest_hops
        self._follow(octaves, log_pitch, starts)

    def pause(self) -> None:
        """Take a hop in which nothing is heard."""
        if self.at_rest:
            return
        self._hops_to_rest -= 1
        if self.at_rest:
            self.reset()
            return
        self._voiced = 0.0
        self._follow(np.zeros(OCTAVES), self._log_pitch)

    def gains(self, audio_hz: FloatArray, coarse: bool = False) -> FloatArray:
        """Return the factor on partials at these audio frequencies, in this hop, 0 to 1.

        coarse: they are not known well enough to tell whether they lie on harmonics of a pitch.
        """
        over_db = self._level - self._voice_limit()
        hidden = (1.0 - self._voiced) * _ramp(float(over_db.max()), "excess_db")
        excess = np.maximum(hidden, _ramps(over_db - CLEAR_DB * self._voiced, "excess_db"))
        spoken = (1.0 - excess) * _ramps(self._level - self._background, "background_db")
        share = np.interp(audio_hz, self._centres_hz, spoken) * _ramps(audio_hz, "spared_hz")
        if not coarse:
            harmonic = audio_hz / math.exp(self._log_pitch)
            apart = np.abs(harmonic - np.rint(harmonic)) - APART_A_HARMONIC * harmonic
            share *= 1.0 - self._voiced * _ramps(apart, "between")
        lowered: FloatArray = 10.0 ** (-self._suppression_db / 20.0 * self.belief * share)
        return lowered

    def _voice_limit(self) -> FloatArray:
        """Return the level of each octave up to which it can be the voice's."""
        limit = self._voice.copy()
        # Consonants hiss where vowels have little: as loud as these are anywhere.
        limit[-2:] = limit.max()
        return limit

    def _follow(self, octaves: FloatArray, log_pitch: float, starts: bool = False) -> None:
        """Bring levels, averages and belief up to this hop; starts: the first after rest."""
        total = float(octaves.sum())
        self._peak = max(total, self._peak_fall * self._peak)
        least = UNHEARD * self._peak + SILENT_POWER
        if starts:
            # As if there had been silence before, so far down that the volume does not matter.
            least_db = 10.0 * math.log10(least / SILENT_POWER)
            for levels in (self._fast, self._slow, self._voice, self._background):
                levels[:] = least_db
        self._level = 10.0 * np.log10((octaves + least) / SILENT_POWER)
        vowels = 10.0 * math.log10((float(octaves[VOWELS].sum()) + least) / SILENT_POWER)
        loudness = 10.0 * math.log10((total + least) / (self._peak + least))
        weight = _ramp(loudness, "quiet_db")
        levels = np.append(self._level[1:], vowels)
        self._note_swing(levels, self._average * max(weight, QUIET_SHARE))
        self._note_pitch(log_pitch, self._average * weight)
        self._believe()
        learnt = np.maximum(self._level - self._voice, 0.0) * (self._learnt * self._voiced)
        self._voice = np.maximum(self._voice - self._voice_fall_db, self._voice + learnt)
        change = self._level - self._background
        rise = np.minimum(change, self._background_rise_db)
        self._background += np.where(change > 0.0, rise, self._background_fall * change)

    def _note_swing(self, levels: FloatArray, weight: float) -> None:
        self._fast += self._fast_share * (levels - self._fast)
        self._slow += self._slow_share * (levels - self._slow)
        swing = np.clip(self._fast - self._slow, -SWING_MAX_DB, SWING_MAX_DB)
        self._swing += weight * (float(swing[-1]) ** 2 - self._swing)
        against = swing[:-1] - swing[:-1].mean()
        self._balance += weight * (float((against * against).mean()) - self._balance)

    def _note_pitch(self, log_pitch: float, weight: float) -> None:
        change = (log_pitch - self._log_pitch) / STEADY_PITCH
        self._log_pitch = log_pitch
        steady = self._voiced / (1.0 + change * change)
        self._voicing += weight * (self._voiced - self._voicing)
        self._steady += weight * (steady - self._steady)

    def _believe(self) -> None:
        """Move the belief by what the four cues say; its own height moves their threshold."""
        likely = (
            _ramp(self._voicing, "voicing")
            * _ramp(math.sqrt(self._swing), "swing_db")
            * _ramp(math.sqrt(self._balance), "balance_db")
            * (1.0 - _ramp(self._steady / (self._voicing + 1e-3), "resting"))
        )
        threshold = LIKELY + (LIKELY_STILL - LIKELY) * self.belief
        speed = min(1.0, max(-1.0, (likely - threshold) / SURE))
        step = speed * (self._attack if speed > 0.0 else self._release)
        self.belief = min(1.0, max(0.0, self.belief + step))


def speech_settings(speech: SpeechSuppressor | None, bin_hz: float, bins: int) -> dict[str, Any]:
    """Return what native/speech.c works by; without suppression the same, unused, at 0 dB."""
    form = speech or SpeechSuppressor(0.0, bin_hz, bins, 1.0)
    return {
        "speech_db": form._suppression_db,
        "speech_average": form._average,
        "speech_fast": form._fast_share,
        "speech_slow": form._slow_share,
        "speech_learnt": form._learnt,
        "speech_background_fall": form._background_fall,
        "speech_background_rise_db": form._background_rise_db,
        "speech_voice_fall_db": form._voice_fall_db,
        "speech_peak_fall": form._peak_fall,
        "speech_attack": form._attack,
        "speech_release": form._release,
        "speech_rest_hops": float(form._rest_hops),
        "speech_quiet_share": QUIET_SHARE,
        "speech_swing_max_db": SWING_MAX_DB,
        "speech_silent_power": SILENT_POWER,
        "speech_unheard": UNHEARD,
        "speech_even": EVEN,
        "speech_equal": EQUAL,
        "speech_flat": FLAT,
        "speech_steady_pitch": STEADY_PITCH,
        "speech_likely": LIKELY,
        "speech_likely_still": LIKELY_STILL,
        "speech_sure": SURE,
        "speech_clear_db": CLEAR_DB,
        "speech_apart": APART_A_HARMONIC,
        "speech_edges": np.array(form._edges, dtype=np.float64),
        "speech_centres_hz": form._centres_hz,
        "speech_log_pitches": form._log_pitches,
        "speech_teeth": form._teeth.reshape(2, -1),
        "speech_ramps": np.array(list(RAMPS.values())),
    }


def _teeth(pitches_hz: FloatArray, bin_hz: float, bins: int) -> FloatArray:
    """Return where combs have teeth, and where none, in bins: (2, pitches, teeth), 0 for unused."""
    on = pitches_hz[:, None] * np.arange(1, COMB_TEETH + 1)
    between = on - 0.5 * pitches_hz[:, None]
    used = on <= min(COMB_TOP_HZ, (bins - 2) * bin_hz)
    return np.stack((np.where(used, on, 0.0), np.where(used, between, 0.0))) / bin_hz


def _share(hop_s: float, time_s: float) -> float:
    """Return the share of a difference that an average over a time takes on in a hop."""
    return 1.0 - math.exp(-hop_s / time_s)


def _ramp(value: float, name: str) -> float:
    low, high = RAMPS[name]
    return min(1.0, max(0.0, (value - low) / (high - low)))


def _ramps(values: FloatArray, name: str) -> FloatArray:
    low, high = RAMPS[name]
    return np.clip((values - low) / (high - low), 0.0, 1.0)
