"""One voice, tick by tick and hop by hop: how its partials go on by what its windows show."""

from functools import partial
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import rfft

from audioflinger_hook.transform.arrays import FloatArray, IntArray
from tests.oracle.analysis import strongest_principal
from tests.oracle.fresh import Fresh
from tests.oracle.loudness import at_hz, excitation, loudness
from tests.oracle.onsets import Onsets
from tests.oracle.partials import Partials
from tests.oracle.speech import Speech, cues
from tests.oracle.strength import Strength

Told = tuple[float, float, float]
"""Hz of audio, Hz of vibration, amplitude in full scale."""


def level_ratio(mapping, found):
    """Return the ratio of one window's vibration level to its level by energy: 1 for a steady tone,
    1 / M for M equal ones by `tonal`, always 1 by `energy`."""
    if mapping.energy_mapping or not len(found):
        return 1.0
    strength = mapping.amplitudes(found.amplitude, found.r)
    energy = (found.amplitude * found.r).sum() / mapping.full_scale_r
    return float(np.sqrt((strength * strength).sum() / energy))


class Voice:
    """What one voice remembers from hop to hop. ringing: hops until the low-pass is at rest;
    limited: samples that the ceiling has lowered; told: what the latest hop vibrates; wanted:
    strength at the end of each tick, without loudness 1."""

    def __init__(self, s: Any) -> None:
        self.s = s
        self.strength = Strength(s) if s.loudness_scale.size else None
        self.speech = Speech(s) if s.speech_db > 0.0 else None
        self.partials = Partials(s)
        self.fresh = Fresh(s, self.partials, self._estimate)
        self.ringing = self.limited = 0
        self.told: list[Told] = []
        self.wanted: list[float] = []

    def asleep(self) -> bool:
        """Return whether nothing vibrates, and earlier sound has no effect any more."""
        remembers = self.speech and self.speech.hops_to_rest
        return not (self.ringing or self.partials.sounding or remembers)

    def hear(self, sound: FloatArray, ends: IntArray) -> None:
        """Analyse band-passed sound (frames,) whose ticks end before some frames. Each result is a
        function of one window, so all windows are taken at once."""
        s, self.sound, self.onsets = self.s, sound, Onsets(self.s, sound, ends)
        self.partials.glides, self.fresh.glides = [], []
        padded = np.concatenate((np.zeros(s.window_frames), sound))
        windows = sliding_window_view(padded, s.window_frames)[ends[s.ticks - 1 :: s.ticks]]
        spectra = rfft(windows * s.window, s.fft_length)[:, : s.bins]
        self.principal = strongest_principal(s, spectra)
        self.wanted = []
        if self.strength:
            self.strength.rest()
            heard = sound[ends[0] - s.tick_frames : ends[-1]] if ends.size else sound[:0]
            short = excitation(s, heard, self.onsets.power)
            self.loudness = list(zip(*loudness(s, short), strict=True))
        if self.speech:
            self.cues = cues(s, spectra)

    def advance(self, tick: int, hops: slice | None) -> None:
        """Take the next tick. hops: the frames of the hops under the window, if one ends here."""
        self.wanted.append(self.strength.follow(*self.loudness[tick]) if self.strength else 1.0)
        if hops:
            self._end_hop(tick, np.abs(self.sound[hops]).max() >= self.s.silence)
        if self.onsets.onset[tick] == tick:
            self.fresh.start(tick, self.onsets, self.s.ticks - (tick + 1) % self.s.ticks)
        if self.fresh.sounding:
            self.ringing = self.s.ring_hops
            self.fresh.play(tick, self.onsets)

    def _end_hop(self, tick, audible):
        """Decide what the next hop does; audible: whether anything in the window can be heard."""
        s, hop, wanted = self.s, tick // self.s.ticks, self.wanted[-1]
        self.fresh.hand_over(tick, self.onsets)
        if self.speech and audible:
            self.speech.hear(*self.cues[hop])
        elif self.speech:
            self.speech.pause()
        found = self.principal.take((self.principal.row == hop) & (wanted > 0.0))
        hz = s.mapping.vibration_hz(found.audio_hz)
        amplitude = self._amplitudes(found, hz)
        told = amplitude * self._gain(amplitude, hz, wanted)
        self.told = list(zip(found.audio_hz, hz, told, strict=True))
        if hz.size or any(one.begun for one in self.partials.sounding.values()):
            room = np.inf if self.strength else max(0.0, s.ceiling - amplitude.sum())
            left = level_ratio(s.mapping, found)
            even = amplitude * at_hz(s, s.gain_table, hz)  # which undoes the ripple of the low-pass
            recent_power = partial(self.onsets.recent_power, tick)
            self.partials.follow(tick, hz, even, room, left, recent_power)
            self.ringing = s.ring_hops
        elif self.partials.sounding:
            self.partials.fade(tick)
        else:
            self.ringing = max(0, self.ringing - 1)

    def _felt(self, amplitude, hz):
        return float(np.linalg.norm(amplitude * at_hz(self.s, self.s.felt_weights, hz)))

    def _gain(self, amplitude, hz, wanted):
        """Return the factor that makes amplitudes as strong as is wanted, under the ceiling."""
        if not self.strength or not self._felt(amplitude, hz):
            return float(not self.strength)
        wanted_gain = wanted / self._felt(amplitude, hz)
        return min(self.s.gain_max, wanted_gain, self.s.ceiling / amplitude.sum())

    def _amplitudes(self, found, hz):
        """Return the amplitudes of a hop's partials: mapping and speech; by loudness, only their
        proportion matters; else the ceiling."""
        s, tilt = self.s, np.ones(hz.size)
        if self.strength and hz.size:
            # What is felt well takes less of the room under full scale.
            tilt = at_hz(s, s.felt_weights, hz) ** 0.5
            plain = s.mapping.amplitudes(found.amplitude, found.r) * tilt
        # Speech is lowered before the mapping, so that what it loses is not missing from the rest.
        left = self.speech.gains(found.audio_hz) if self.speech else np.ones(hz.size)
        amplitude = s.mapping.amplitudes(found.amplitude * left, found.r * left) * tilt
        if self.strength and self.speech and hz.size:
            share = self._felt(amplitude, hz) / self._felt(plain, hz)
            self.strength.speech_left = min(1.0, share)
        if self.strength or amplitude.sum() <= s.ceiling:
            return amplitude
        self.limited += s.hop_frames
        return amplitude * (s.ceiling / amplitude.sum())

    def _estimate(self, tick, group):
        """Return Hz of vibration, weight and amplitude of what has begun in a group of bands."""
        hz, weight = self.onsets.estimate(tick, group)
        s, (_, level) = self.s, self.onsets.known(tick)
        if self.strength:
            level *= float(at_hz(s, s.felt_weights, hz)) ** 0.5
        if self.speech:
            audio_hz = np.array([s.mapping.audio_hz(hz)])
            level *= float(self.speech.gains(audio_hz, coarse=True)[0])
        return hz, weight, weight * level * float(at_hz(s, s.gain_table, hz))
