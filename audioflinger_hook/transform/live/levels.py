"""How strongly partials vibrate: amplitude mapping, loudness and speech, under a ceiling."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.live.loudness import LoudnessFollower
from audioflinger_hook.transform.live.speech import SpeechSuppressor
from audioflinger_hook.transform.live.synthesis import limit_amplitudes
from audioflinger_hook.transform.principal import Principals
from audioflinger_hook.transform.spectrum import ComplexArray


class Levels:
    """The levels of one channel's partials, from hop to hop. Use from one thread at a time.

    follower, speech: what follows the loudness and what finds speech; None where it is off.
    """

    def __init__(self, design: LiveDesign) -> None:
        self._mapping = design.mapping
        self._ceiling = design.synthesis.ceiling
        self.follower: LoudnessFollower | None = None
        if design.loudness.loudness_weights.size:
            self.follower = LoudnessFollower(design.loudness)
        self.speech: SpeechSuppressor | None = None
        if design.speech.speech_db > 0.0:
            self.speech = SpeechSuppressor(design.speech)

    def reset(self) -> None:
        """Return to the state of a new stream."""
        if self.follower:
            self.follower.reset()
        if self.speech:
            self.speech.reset()

    @property
    def at_rest(self) -> bool:
        """Whether the speech that was heard has no effect any more."""
        return self.speech is None or self.speech.at_rest

    def loudness_db(self, spectra: ComplexArray) -> Sequence[float]:
        """Return the loudness of each window of spectra (rows, bins); 0 if none is followed."""
        return self.follower.loudness_db(spectra) if self.follower else [0.0] * len(spectra)

    def rest(self) -> None:
        """Count a hop in which nothing is heard and nothing is played."""
        if self.follower:
            self.follower.rest()

    def hear(self, spectrum: ComplexArray, loudness_db: float) -> float:
        """Count a hop that is heard; return the strength of its loudness."""
        strength = self.follower.strength(loudness_db) if self.follower else 1.0
        if self.speech:
            self.speech.add_hop(spectrum)
        return strength

    def hear_silence(self) -> None:
        """Count a hop in which nothing is heard."""
        self.rest()
        if self.speech:
            self.speech.add_silence()

    def amplitudes(
        self, found: Principals, hz: FloatArray, strength: float
    ) -> tuple[FloatArray, bool]:
        """Return the amplitudes of one hop's partials, and whether they were limited.

        hz: of their vibration. strength: what the follower makes of their loudness.
        """
        amplitude = self._mapping.amplitudes(found.amplitude, found.r)
        gain, tilt = 1.0, np.ones(hz.size)
        if self.follower:
            # What is felt well takes less of the room under full scale.
            felt = self.follower.felt_weight(hz)
            tilt = np.sqrt(felt)
            felt *= amplitude * tilt
            gain = self.follower.gain_for(strength, float((felt * felt).sum()))
        if self.speech:
            # Before the amplitude mapping, so that what speech loses is not missing from the rest;
            # after the follower, which would turn the rest up.
            left = self.speech.gains(found.audio_hz)
            amplitude = self._mapping.amplitudes(found.amplitude * left, found.r * left)
        amplitude = amplitude * tilt * gain
        if self.follower:
            amplitude = self.follower.concentrated(amplitude, hz, self._ceiling)
        return limit_amplitudes(amplitude, self._ceiling)

    def onset_amplitude(self, hz: float, weight: float, level: float, power: FloatArray) -> float:
        """Return the amplitude of what begins at a vibration frequency in Hz.

        weight: the share of its level that the amplitude mapping leaves. power: of the onset, in
        each band.
        """
        amplitude = weight * level
        if self.follower:
            amplitude = weight * self.follower.onset_strength(power, level)
        if self.speech:
            audio_hz = np.array([self._mapping.audio_hz(hz)])
            amplitude *= float(self.speech.gains(audio_hz, coarse=True)[0])
        return amplitude
