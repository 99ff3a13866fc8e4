"""Speech detected in the sound, and the gain of each partial while it lasts.

Speech is known by its spectrum and how that moves from hop to hop:

- voicing: a comb of harmonics of a pitch between 70 and 320 Hz stands out of the valleys between;
- swing: the level rises and falls at the rate of syllables, some 2 to 8 Hz;
- balance: so do the octaves against one another, as vowels and consonants take turns;
- pitch: it moves all the time, where notes and alarms rest on theirs.

The first is spectral, the others are added by modulation: they tell speech from music (E. Scheirer
and M. Slaney, "Construction and evaluation of a robust multifeature speech/music discriminator",
ICASSP 1997). All four must hold. They are averages over 0.3 s, so speech is known that much late;
the vibration waits for nothing.

Each partial is lowered by the share of it that can be speech. These are not lowered: partials under
80 Hz; partials between the harmonics of a clear pitch; an octave that is no louder than its own
background, or far louder than the voice has been; a hop without pitch in which any octave is louder
than that. So an explosion is felt while somebody speaks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, IntArray
from audioflinger_hook.transform.design.speech import RAMPS, SpeechDesign
from audioflinger_hook.transform.spectrum import ComplexArray

OCTAVES = 6
VOWELS = slice(1, 5)
"""Octaves whose common level swings with the syllables."""

COMB_POWER = 0.2
"""Combs add up powers of this exponent: many weak harmonics count, one loud tone does not."""


class SpeechSuppressor:
    """Follows one channel's spectra, one a hop, and gives the gain of each partial.

    `belief` is how sure it is of speech, 0 to 1. The numbers depend on the sequence of hops alone.
    Use from one thread at a time.
    """

    def __init__(self, design: SpeechDesign) -> None:
        self._design = design
        ramps = zip(RAMPS, design.speech_ramps.tolist(), strict=True)
        self._ramp: dict[str, tuple[float, float]] = {
            name: (low, high) for name, (low, high) in ramps
        }
        self._edges = [int(edge) for edge in design.speech_edges]
        self._pitches = design.speech_log_pitches.size
        teeth = design.speech_teeth.reshape(2, self._pitches, -1)
        self._below: IntArray = teeth.astype(np.intp)
        self._beyond = teeth - self._below
        self._used = teeth > 0.0
        self._comb_bins = int(self._below.max()) + 2
        self.reset()

    def reset(self) -> None:
        """Return to the state of a new stream."""
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
        """Whether earlier sound has no effect any more."""
        return not self._hops_to_rest

    def add_hop(self, spectrum: ComplexArray) -> None:
        """Take the next hop's spectrum, (bins or more,)."""
        design = self._design
        power = spectrum.real**2 + spectrum.imag**2
        edges = self._edges
        octaves = np.array([power[edges[one] : edges[one + 1]].sum() for one in range(OCTAVES)])
        comb = power[: self._comb_bins]
        roots = (comb + design.speech_even * comb.max()) ** COMB_POWER
        here = roots.take(self._below)
        teeth = here + self._beyond * (roots.take(self._below + 1) - here)
        on, between = np.where(self._used, teeth, 0.0).sum(axis=2)
        contrast = (on - between) / (on + between + design.speech_silent_power)
        best = int((contrast >= contrast.max() - design.speech_equal).argmax())
        log_pitch = float(design.speech_log_pitches[best])
        if 0 < best < self._pitches - 1:
            below, top, above = contrast[best - 1 : best + 2]
            offset = (below - above) / (2.0 * min(below - 2.0 * top + above, -design.speech_flat))
            step = design.speech_log_pitches[1] - design.speech_log_pitches[0]
            log_pitch += float(min(0.5, max(-0.5, offset)) * step)
        self._voiced = _ramp(float(contrast[best]), self._ramp["voiced"])
        starts = self.at_rest
        self._hops_to_rest = int(design.speech_rest_hops)
        self._follow(octaves, log_pitch, starts)

    def add_silence(self) -> None:
        """Take a hop of silence."""
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
        design = self._design
        over_db = self._level - self._voice_limit()
        hidden = (1.0 - self._voiced) * _ramp(float(over_db.max()), self._ramp["excess_db"])
        excess = np.maximum(
            hidden, _ramps(over_db - design.speech_clear_db * self._voiced, self._ramp["excess_db"])
        )
        spoken = (1.0 - excess) * _ramps(
            self._level - self._background, self._ramp["background_db"]
        )
        share = np.interp(audio_hz, design.speech_centres_hz, spoken) * _ramps(
            audio_hz, self._ramp["spared_hz"]
        )
        if not coarse:
            harmonic = audio_hz / math.exp(self._log_pitch)
            apart = np.abs(harmonic - np.rint(harmonic)) - design.speech_apart * harmonic
            share *= 1.0 - self._voiced * _ramps(apart, self._ramp["between"])
        lowered: FloatArray = 10.0 ** (-design.speech_db / 20.0 * self.belief * share)
        return lowered

    def _voice_limit(self) -> FloatArray:
        """Return the level of each octave up to which it can be the voice's."""
        limit = self._voice.copy()
        # Consonants hiss where vowels have little: as loud as these are anywhere.
        limit[-2:] = limit.max()
        return limit

    def _follow(self, octaves: FloatArray, log_pitch: float, starts: bool = False) -> None:
        """Bring levels, averages and belief up to this hop; starts: the first after rest."""
        design, silent_power = self._design, self._design.speech_silent_power
        total = float(octaves.sum())
        self._peak = max(total, design.speech_peak_fall * self._peak)
        least = design.speech_unheard * self._peak + silent_power
        if starts:
            # As if there had been silence before, so far down that the volume does not matter.
            least_db = 10.0 * math.log10(least / silent_power)
            for levels in (self._fast, self._slow, self._voice, self._background):
                levels[:] = least_db
        self._level = 10.0 * np.log10((octaves + least) / silent_power)
        vowels = 10.0 * math.log10((float(octaves[VOWELS].sum()) + least) / silent_power)
        loudness = 10.0 * math.log10((total + least) / (self._peak + least))
        weight = _ramp(loudness, self._ramp["quiet_db"])
        levels = np.append(self._level[1:], vowels)
        self._update_swing(levels, design.speech_average * max(weight, design.speech_quiet_share))
        self._update_pitch(log_pitch, design.speech_average * weight)
        self._update_belief()
        learnt = np.maximum(self._level - self._voice, 0.0) * (design.speech_learnt * self._voiced)
        self._voice = np.maximum(self._voice - design.speech_voice_fall_db, self._voice + learnt)
        change = self._level - self._background
        rise = np.minimum(change, design.speech_background_rise_db)
        self._background += np.where(change > 0.0, rise, design.speech_background_fall * change)

    def _update_swing(self, levels: FloatArray, weight: float) -> None:
        design = self._design
        self._fast += design.speech_fast * (levels - self._fast)
        self._slow += design.speech_slow * (levels - self._slow)
        swing = np.clip(
            self._fast - self._slow, -design.speech_swing_max_db, design.speech_swing_max_db
        )
        self._swing += weight * (float(swing[-1]) ** 2 - self._swing)
        against = swing[:-1] - swing[:-1].mean()
        self._balance += weight * (float((against * against).mean()) - self._balance)

    def _update_pitch(self, log_pitch: float, weight: float) -> None:
        design = self._design
        change = (log_pitch - self._log_pitch) / design.speech_steady_pitch
        self._log_pitch = log_pitch
        steady = self._voiced / (1.0 + change * change)
        self._voicing += weight * (self._voiced - self._voicing)
        self._steady += weight * (steady - self._steady)

    def _update_belief(self) -> None:
        """Move the belief by what the four cues say; its own height moves their threshold."""
        design = self._design
        likely = (
            _ramp(self._voicing, self._ramp["voicing"])
            * _ramp(math.sqrt(self._swing), self._ramp["swing_db"])
            * _ramp(math.sqrt(self._balance), self._ramp["balance_db"])
            * (1.0 - _ramp(self._steady / (self._voicing + 1e-3), self._ramp["resting"]))
        )
        threshold = (
            design.speech_likely + (design.speech_likely_still - design.speech_likely) * self.belief
        )
        speed = min(1.0, max(-1.0, (likely - threshold) / design.speech_sure))
        step = speed * (design.speech_attack if speed > 0.0 else design.speech_release)
        self.belief = min(1.0, max(0.0, self.belief + step))


def _ramp(value: float, ramp: Sequence[float]) -> float:
    low, high = ramp
    return min(1.0, max(0.0, (value - low) / (high - low)))


def _ramps(values: FloatArray, ramp: Sequence[float]) -> FloatArray:
    low, high = ramp
    return np.clip((values - low) / (high - low), 0.0, 1.0)
