"""Speech in the sound, and how far it lowers partials: "Speech suppression" in docs/transform.md.

Swing and balance are cues that tell speech from music by modulation (E. Scheirer and M. Slaney,
ICASSP 1997). s: the numbers and tables of `SpeechDesign`.
"""

from itertools import pairwise
from typing import Any

import numpy as np

from audioflinger_hook.transform.arrays import ComplexArray, FloatArray
from audioflinger_hook.transform.design.speech import RAMPS

OCTAVES, VOWELS = 6, slice(1, 5)
"""Number of octaves, and those whose common level varies with the syllables."""


def ramp(s: Any, name: str, value: FloatArray | float) -> FloatArray:
    """Return how far a value is up one of `RAMPS`, 0 to 1."""
    low, high = s.speech_ramps[list(RAMPS).index(name)]
    return np.asarray(np.clip((value - low) / (high - low), 0.0, 1.0))


def cues(s: Any, spectra: ComplexArray) -> list[tuple[FloatArray, float, float]]:
    """Return what each of the spectra (hops, bins) says: power of the octaves (6,), voicing from 0
    to 1, and logarithm of the pitch. A pitch is heard by the comb of its harmonics."""
    power, edges = spectra.real**2 + spectra.imag**2, s.speech_edges.astype(int)
    octaves = [power[:, a:b].sum(axis=1) for a, b in pairwise(edges)]
    pitches = s.speech_log_pitches
    teeth = s.speech_teeth.reshape(2, pitches.size, -1)
    below = teeth.astype(int)
    comb = power[:, : int(below.max()) + 2]
    roots = (comb + s.speech_even * comb.max(axis=1, keepdims=True)) ** 0.2  # many weak lines
    at_teeth = roots[:, below] + (teeth - below) * (roots[:, below + 1] - roots[:, below])
    on, between = np.moveaxis(np.where(teeth > 0.0, at_teeth, 0.0).sum(axis=3), 1, 0)
    contrast = (on - between) / (on + between + s.speech_silent_power)
    # Of combs that are equally good the lowest counts; its place is refined by a parabola.
    most = contrast.max(axis=1, keepdims=True)
    best = (contrast >= most - s.speech_equal).argmax(axis=1)
    hop, last = np.arange(len(power)), pitches.size - 1
    under, top, over = (contrast[hop, (best + by).clip(0, last)] for by in (-1, 0, 1))
    curved = np.minimum(under - 2.0 * top + over, -s.speech_flat)
    offset = np.clip((under - over) / (2.0 * curved), -0.5, 0.5) * ((best > 0) & (best < last))
    log_pitch = pitches[best] + offset * (pitches[1] - pitches[0])
    return list(zip(np.stack(octaves, 1), ramp(s, "voiced", top), log_pitch, strict=True))


class Speech:
    """What one voice remembers of speech; `belief` is the probability of speech, 0 to 1. By octave,
    in dB: level in this hop, of the voice, of the background; fast and slow averages of the level,
    where the vowels stand for the first octave, as the last entry."""

    def __init__(self, s: Any) -> None:
        self.s = s
        self._forget()

    def _forget(self):
        self.belief = self.voiced = self.log_pitch = self.peak = self.hops_to_rest = 0.0
        self.swing = self.balance = self.voicing = self.steady = 0.0
        self.fast, self.slow, self.level, self.voice, self.background = np.zeros((5, OCTAVES))

    def pause(self) -> None:
        """Take a hop of silence."""
        left = self.hops_to_rest - 1.0
        if left > 0.0:
            self.hear(np.zeros(OCTAVES), 0.0, self.log_pitch)
            self.hops_to_rest = left
        else:
            self._forget()

    def hear(self, octaves: FloatArray, voiced: float, log_pitch: float) -> None:
        """Take the cues of the next hop: "Detection"."""
        s, silent, total = self.s, self.s.speech_silent_power, float(octaves.sum())
        self.peak = max(total, s.speech_peak_fall * self.peak)
        least = s.speech_unheard * self.peak + silent
        if not self.hops_to_rest:  # as if there had been silence, far below any volume
            for levels in (self.fast, self.slow, self.voice, self.background):
                levels[:] = 10.0 * np.log10(least / silent)
        self.voiced, self.hops_to_rest = voiced, s.speech_rest_hops
        self.level = 10.0 * np.log10((octaves + least) / silent)
        vowels = 10.0 * np.log10((octaves[VOWELS].sum() + least) / silent)
        quiet_db = 10.0 * np.log10((total + least) / (self.peak + least))
        weight = float(ramp(s, "quiet_db", quiet_db))
        levels = np.append(self.level[1:], vowels)
        self.fast += s.speech_fast * (levels - self.fast)
        self.slow += s.speech_slow * (levels - self.slow)
        swing = np.clip(self.fast - self.slow, -s.speech_swing_max_db, s.speech_swing_max_db)
        share = s.speech_average * max(weight, s.speech_quiet_share)
        self.swing += share * (swing[-1] ** 2 - self.swing)
        self.balance += share * (swing[:-1].var() - self.balance)
        change = (log_pitch - self.log_pitch) / s.speech_steady_pitch
        self.log_pitch, share = log_pitch, s.speech_average * weight
        self.voicing += share * (voiced - self.voicing)
        self.steady += share * (voiced / (1.0 + change * change) - self.steady)
        swings = ramp(s, "swing_db", self.swing**0.5) * ramp(s, "balance_db", self.balance**0.5)
        moves = 1.0 - ramp(s, "resting", self.steady / (self.voicing + 1e-3))
        over = ramp(s, "voicing", self.voicing) * swings * moves - s.speech_likely
        over = over - (s.speech_likely_still - s.speech_likely) * self.belief
        speed = float(np.clip(over / s.speech_sure, -1.0, 1.0))
        step = speed * (s.speech_attack if speed > 0.0 else s.speech_release)
        self.belief = min(max(self.belief + step, 0.0), 1.0)
        more = np.maximum(self.level - self.voice, 0.0) * (s.speech_learnt * voiced)
        self.voice = self.voice + np.maximum(-s.speech_voice_fall_db, more)
        over = self.level - self.background
        rises = np.minimum(over, s.speech_background_rise_db)
        self.background += np.where(over > 0.0, rises, s.speech_background_fall * over)

    def gains(self, audio_hz: FloatArray, coarse: bool = False) -> FloatArray:
        """Return the factor on partials at audio frequencies, 0 to 1: "Selection". coarse: they are
        not known well enough to tell whether they lie on harmonics of the pitch."""
        s, limit = self.s, self.voice.copy()
        limit[-2:] = limit.max()  # consonants may be as loud as vowels are anywhere
        over_db = self.level - limit
        hidden = (1.0 - self.voiced) * ramp(s, "excess_db", over_db.max())
        excess = ramp(s, "excess_db", over_db - s.speech_clear_db * self.voiced)
        spoken = ramp(s, "background_db", self.level - self.background)
        spoken = spoken * (1.0 - np.maximum(hidden, excess))
        share = np.interp(audio_hz, s.speech_centres_hz, spoken) * ramp(s, "spared_hz", audio_hz)
        if not coarse:
            harmonic = audio_hz / np.exp(self.log_pitch)
            apart = np.abs(harmonic - np.rint(harmonic)) - s.speech_apart * harmonic
            share = share * (1.0 - self.voiced * ramp(s, "between", apart))
        return np.asarray(10.0 ** (-s.speech_db / 20.0 * self.belief * share))
