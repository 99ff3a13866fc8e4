"""The reference form: the paper's equations literally, unit by unit, in float64.

It is what published figures mean and what the live form is measured against. Its flaws are the
paper's and stay: steps at unit edges, a lag of one unit and more, a hard gate.
"""

from __future__ import annotations

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.bandpass import BandPass
from audioflinger_hook.transform.levels import law_amplitudes
from audioflinger_hook.transform.parameters import TransformParameters
from audioflinger_hook.transform.principal import PrincipalFinder, Principals
from audioflinger_hook.transform.scaling import vibration_hz
from audioflinger_hook.transform.spectrum import Spectrum, magnitude

UNITS_AT_ONCE = 16
"""Units analysed in one batch: bounds the memory of a block of any length."""


class ReferenceTransform:
    """The reference form of one channel, continued from block to block.

    `process` gives as many frames as it takes, late by `latency_frames` = one unit (N). Held by
    one thread at a time.
    """

    onset_after_frames = 0
    """Its units are cut from the stream's beginning on, as the paper's are."""

    asleep = False

    follower = None
    frames_to_hop = 0

    def __init__(self, parameters: TransformParameters, samplerate: int) -> None:
        self._parameters = parameters
        self._samplerate = samplerate
        self._spectrum = Spectrum(parameters, samplerate)
        self._finder = PrincipalFinder(parameters, self._spectrum.bin_hz, self._spectrum.bins)
        self._bandpass = BandPass(parameters, samplerate)
        self._full_scale_r = parameters.unit_strength_hz(samplerate)
        self._turns = 2.0 * np.pi * np.arange(self._spectrum.window_frames) / samplerate
        self.latency_frames = self._spectrum.window_frames
        self.limited_frames = 0
        self.reset()

    def reset(self) -> None:
        """Return to the state of a new stream."""
        self._bandpass.reset()
        self._pending = np.zeros(0)
        self._ready = np.zeros(self.latency_frames)

    def begin_hop(self) -> None:
        """It never does."""

    def process(self, mono: FloatArray) -> FloatArray:
        """Return the next (frames,) of vibration, `latency_frames` behind the sound."""
        ready = np.concatenate((self._ready, self._render(self.cut(mono))))
        self._ready = ready[mono.size :]
        return ready[: mono.size]

    def finish(self) -> FloatArray:
        """Return the `latency_frames` still owed, and begin anew."""
        owed = np.concatenate((self._ready, self._render(self.cut_last())))
        self.reset()
        return owed[: self.latency_frames]

    def cut(self, mono: FloatArray) -> FloatArray:
        """Return the band-passed unit sequences that the next frames complete, (units, N)."""
        pending = np.concatenate((self._pending, self._bandpass.process(mono)))
        whole = pending.size - pending.size % self.latency_frames
        self._pending = pending[whole:]
        return pending[:whole].reshape(-1, self.latency_frames)

    def cut_last(self) -> FloatArray:
        """Return the last unit sequence, padded with zeros: (1, N); (0, N) if none."""
        padding = -self._pending.size % self.latency_frames
        last = np.concatenate((self._pending, np.zeros(padding)))
        self._pending = last[:0]
        return last.reshape(-1, self.latency_frames)

    def analyse(self, units: FloatArray) -> Principals:
        """Return the principal frequencies of band-passed unit sequences (units, N)."""
        return self._finder.find(magnitude(self._spectrum.transform(units)))

    def _render(self, units: FloatArray) -> FloatArray:
        """Return the vibration of unit sequences (units, N), end to end."""
        vibration = np.zeros(units.shape)
        for first in range(0, len(units), UNITS_AT_ONCE):
            batch = units[first : first + UNITS_AT_ONCE]
            found = self.analyse(batch)
            edges = found.boundaries(len(batch))
            hz = vibration_hz(found.audio_hz, self._parameters)
            for row in range(len(batch)):
                mine = slice(edges[row], edges[row + 1])
                if mine.start < mine.stop:
                    vibration[first + row] = self._superpose(found.take(mine), hz[mine])
        return vibration.reshape(-1)

    def _superpose(self, found: Principals, hz: FloatArray) -> FloatArray:
        """Return one unit of equations (5)-(7), time counted from the unit's own start."""
        weight = law_amplitudes(found.amplitude, found.r, self._full_scale_r, self._parameters)
        unit = np.zeros(self.latency_frames)
        for partial in range(len(found)):
            unit += weight[partial] * np.cos(hz[partial] * self._turns)
        return unit
