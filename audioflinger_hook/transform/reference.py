"""The reference form: the paper's equations in float64, computed for one unit after another.

A unit (the paper's unit sequence) is an analysis window of N frames. Units do not overlap.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from audioflinger_hook.core.compiled_core import GLIDE_NUMBERS
from audioflinger_hook.transform import input_stage
from audioflinger_hook.transform.arrays import FloatArray, Frames, IntArray
from audioflinger_hook.transform.downmix import MonoMix
from audioflinger_hook.transform.mapping import VibrationMapping
from audioflinger_hook.transform.parameters import TransformParameters
from audioflinger_hook.transform.principal import PrincipalFinder, Principals, Spectrum, magnitude
from device.layouts import downmix

EPSILON = 2.0**-52
ANGLE_ERROR = 8.0
"""Bound of the difference of angles in `exact` and `single`, in epsilons of the largest angle. Each
method rounds an angle three times by half an epsilon, so the difference is at most 3."""

TERM_ERROR = 16.0
"""Bound of the error of adding one partial, in epsilons of its weight. The error is at most 13."""


class Superposition:
    """Sums of cosines with non-negative weights over the N frames of one unit."""

    def __init__(self, frames: int, samplerate: int) -> None:
        self._frames = frames
        self._turns = 2.0 * np.pi * np.arange(frames) / samplerate
        self._fine = math.isqrt(frames - 1) + 1
        self._coarse_turns = self._turns[:: self._fine]
        self._fine_turns = self._turns[: self._fine]

    def exact(self, weight: FloatArray, hz: FloatArray) -> FloatArray:
        """Return the sum of weight cos(2 pi hz t) over all partials, (N,)."""
        unit = np.zeros(self._frames)
        for partial in range(len(weight)):
            unit += weight[partial] * np.cos(hz[partial] * self._turns)
        return unit

    def single(self, weight: FloatArray, hz: FloatArray, edges: IntArray) -> FloatArray:
        """Return each unit's sum of partials, (units, N); rounded to float32, it equals `exact`.

        weight, hz: values for the partials of all units, (partials,). The partials of unit i have
            the indices edges[i] to edges[i + 1] - 1.
        """
        grid = np.zeros((len(edges) - 1, self._coarse_turns.size, self._fine))
        coarse, fine = np.multiply.outer(hz, self._coarse_turns), hz[:, None] * self._fine_turns
        # With cos(a + b) = cos a cos b - sin a sin b, a matrix product adds all partials of a unit.
        left = np.stack((np.cos(coarse), np.sin(coarse)), axis=1) * weight[:, None, None]
        right = np.stack((np.cos(fine), -np.sin(fine)), axis=1)
        for unit, (first, end) in enumerate(pairwise(edges)):
            if first < end:
                rows = left[first:end].reshape(-1, self._coarse_turns.size)
                np.matmul(rows.T, right[first:end].reshape(-1, self._fine), out=grid[unit])
        sums = grid.reshape(len(grid), -1)
        if weight.size:
            self._redo(sums, weight, hz, edges)
        return sums[:, : self._frames]

    def _redo(self, sums: FloatArray, weight: FloatArray, hz: FloatArray, edges: IntArray) -> None:
        """Compute a sum again, as in `exact`, if its error could change the float32 value."""
        counts = np.diff(edges)
        totals = np.add.reduceat(np.append(weight, 0.0), edges[:-1]) * (counts > 0)
        epsilons = ANGLE_ERROR * float(hz.max() * self._turns[-1])
        epsilons += TERM_ERROR * (float(counts.max()) + 1.0)
        error = (epsilons * EPSILON) * totals[:, None]
        shifted = sums - error
        lower = shifted.astype(np.float32)
        np.add(sums, error, out=shifted)
        unsure = np.flatnonzero(lower != shifted.astype(np.float32))
        for unit, frame in zip(*np.divmod(unsure, sums.shape[1]), strict=True):
            if frame < self._frames:
                mine = slice(edges[unit], edges[unit + 1])
                total = 0.0
                for term in weight[mine] * np.cos(hz[mine] * self._turns[frame]):
                    total += term  # same order as in `exact`
                sums[unit, frame] = total


UNITS_AT_ONCE = 8  # units per batch, to limit the memory for long blocks


class ReferenceTransform:
    """The reference form of one channel. The vibration is N frames (one unit) later than the sound.

    single: whether the caller rounds the vibration to float32. A faster method is then used.
    """

    def __init__(
        self, parameters: TransformParameters, samplerate: int, *, single: bool = False
    ) -> None:
        self.samplerate = samplerate
        self._single = single
        self._spectrum = Spectrum.of(parameters, samplerate)
        self._finder = PrincipalFinder(parameters, self._spectrum.bin_hz, self._spectrum.bins)
        self._bandpass = input_stage.BandPass(*input_stage.design_band_pass(parameters, samplerate))
        self._mapping = VibrationMapping.of(parameters, parameters.unit_strength_hz(samplerate))
        self._superposition = Superposition(self._spectrum.window_frames, samplerate)
        self.latency_frames = self._spectrum.window_frames
        self.reset()

    def reset(self) -> None:
        """Start a new stream."""
        self._bandpass.reset()
        self._pending = np.zeros(0)
        self._ready = np.zeros(self.latency_frames)

    def process(self, mono: FloatArray) -> FloatArray:
        """Return the next vibration, (frames,)."""
        ready = np.concatenate((self._ready, self._render(self.cut(mono))))
        self._ready = ready[mono.size :]
        return ready[: mono.size]

    def finish(self) -> FloatArray:
        """End the sound: return the last `latency_frames` of vibration, and reset."""
        owed = np.concatenate((self._ready, self._render(self.cut_last())))
        self.reset()
        return owed[: self.latency_frames]

    def cut(self, mono: FloatArray) -> FloatArray:
        """Return the band-passed units whose last frame is in `mono`, (units, N)."""
        pending = np.concatenate((self._pending, self._bandpass.process(mono)))
        whole = pending.size - pending.size % self.latency_frames
        self._pending = pending[whole:]
        return pending[:whole].reshape(-1, self.latency_frames)

    def cut_last(self) -> FloatArray:
        """Return the incomplete unit, padded with zeros, (1, N); (0, N) if there is none."""
        last = np.concatenate((self._pending, np.zeros(-self._pending.size % self.latency_frames)))
        self._pending = last[:0]
        return last.reshape(-1, self.latency_frames)

    def analyse(self, units: FloatArray) -> Principals:
        """Return the principal frequencies of band-passed units, (units, N)."""
        return self._finder.find(magnitude(self._spectrum.transform(units)))

    def _render(self, units: FloatArray) -> FloatArray:
        vibration = np.empty(units.shape)
        for first in range(0, len(units), UNITS_AT_ONCE):
            batch = slice(first, first + UNITS_AT_ONCE)
            vibration[batch] = self._superposed(self.analyse(units[batch]), len(units[batch]))
        return vibration.reshape(-1)

    def _superposed(self, found: Principals, units: int) -> FloatArray:
        """Return the vibration of each unit by equations (5) to (7), (units, N)."""
        edges = found.boundaries(units)
        hz = self._mapping.vibration_hz(found.audio_hz)
        weight = np.empty(len(found))
        for first, end in pairwise(edges):
            unit = slice(first, end)
            weight[unit] = self._mapping.amplitudes(found.amplitude[unit], found.r[unit])
        if self._single:
            return self._superposition.single(weight, hz, edges)
        parts = ((weight[first:end], hz[first:end]) for first, end in pairwise(edges))
        return np.stack([self._superposition.exact(*part) for part in parts])


class ReferenceStream:
    """The reference form of a stream with `channels` channels of sound.

    transforms: one for each channel, or one for the mono mix. weights: see `HapticTransform`.
    """

    told: tuple[tuple[float, float, float], ...] = ()
    limited_samples = 0

    def __init__(
        self,
        transforms: Sequence[ReferenceTransform],
        channels: int,
        weights: FloatArray | None = None,
    ) -> None:
        self.latency_frames = self.tonal_latency_frames = transforms[0].latency_frames
        self.delivered_frames = self.replaced_samples = 0
        self._transforms = transforms
        self._channels = channels
        halves = [downmix(channels)] if len(transforms) == 1 else []
        if weights is not None:
            halves = [weights[:, output] for output in range(len(transforms))]
        self._mixes = [MonoMix(half, transforms[0].samplerate) for half in halves]

    def process(self, frames: Frames) -> FloatArray:
        """Return vibration, (frames, transforms). UsageError: see `HapticTransform.process`."""
        usable, replaced = input_stage.replace_unusable(
            input_stage.fit_block(frames, self._channels)
        )
        self.replaced_samples += replaced
        self.delivered_frames += len(usable)
        rows = input_stage.channel_rows(usable)
        mixed = [mix.process(rows) for mix in self._mixes] or rows
        each = zip(self._transforms, mixed, strict=True)
        return np.stack([one.process(sound) for one, sound in each], axis=1)

    def take_glides(self) -> FloatArray:
        """Return an empty array, because the reference form has no glides."""
        return np.empty((0, GLIDE_NUMBERS))

    def finish(self) -> FloatArray:
        """End the sound: return the last vibration, (latency_frames, transforms), and reset."""
        self.delivered_frames += self.latency_frames
        rest = np.stack([one.finish() for one in self._transforms], axis=1)
        self.reset()
        return rest

    def reset(self) -> None:
        """Start a new stream; `replaced_samples` and `delivered_frames` keep their values."""
        for mix in self._mixes:
            mix.reset()
        for one in self._transforms:
            one.reset()
