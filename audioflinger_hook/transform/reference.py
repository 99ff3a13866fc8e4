"""The reference form: the paper's equations literally, unit by unit, in float64."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from audioflinger_hook.core.compiled_core import GLIDE_NUMBERS
from audioflinger_hook.transform.arrays import FloatArray, Frames, IntArray
from audioflinger_hook.transform.downmix import MonoMix
from audioflinger_hook.transform.input_stage import (
    BandPass,
    channel_rows,
    design_band_pass,
    fit_block,
    replace_unusable,
)
from audioflinger_hook.transform.mapping import VibrationMapping
from audioflinger_hook.transform.parameters import TransformParameters
from audioflinger_hook.transform.principal import PrincipalFinder, Principals, Spectrum, magnitude
from device.layouts import downmix

EPSILON = 2.0**-52
ANGLE_ERROR = 8.0
"""`exact` and `single` each round a frame's time and angle three times, by at most half an epsilon
of the largest angle. Both errors together are 3 epsilons; the bound is more than twice that."""

TERM_ERROR = 16.0
"""If cosines are exact to 4 units in the last place, adding one partial in `exact` or `single` has
an error of at most 13 epsilons of the partial's weight."""


class Superposition:
    """Sums of cosines over the N frames of one unit; weights are not negative. Pure."""

    def __init__(self, frames: int, samplerate: int) -> None:
        self._frames = frames
        self._turns = 2.0 * np.pi * np.arange(frames) / samplerate
        self._fine = math.isqrt(frames - 1) + 1
        self._coarse_turns = self._turns[:: self._fine]
        self._fine_turns = self._turns[: self._fine]

    def exact(self, weight: FloatArray, hz: FloatArray) -> FloatArray:
        """Return the sum of weight cos(2 pi hz t) over (partials,), added in their order: (N,)."""
        unit = np.zeros(self._frames)
        for partial in range(len(weight)):
            unit += weight[partial] * np.cos(hz[partial] * self._turns)
        return unit

    def single(self, weight: FloatArray, hz: FloatArray, edges: IntArray) -> FloatArray:
        """Return the sums of several units, (units, N). As float32 they equal those of `exact`.

        weight, hz: the partials of all units; unit i has those from edges[i] up to edges[i + 1].
        """
        grid = np.zeros((len(edges) - 1, self._coarse_turns.size, self._fine))
        coarse, fine = np.multiply.outer(hz, self._coarse_turns), hz[:, None] * self._fine_turns
        # cos(a + b) = cos a cos b - sin a sin b: one matrix product adds all partials of a unit.
        left = np.stack((np.cos(coarse), np.sin(coarse)), axis=1) * weight[:, None, None]
        right = np.stack((np.cos(fine), -np.sin(fine)), axis=1)
        for unit, (first, end) in enumerate(pairwise(edges)):
            if first < end:
                rows = left[first:end].reshape(-1, self._coarse_turns.size)
                columns = right[first:end].reshape(-1, self._fine)
                np.matmul(rows.T, columns, out=grid[unit])
        sums = grid.reshape(len(grid), -1)
        if weight.size:
            self._settle(sums, weight, hz, edges)
        return sums[:, : self._frames]

    def _settle(
        self, sums: FloatArray, weight: FloatArray, hz: FloatArray, edges: IntArray
    ) -> None:
        """Replace every sum whose error could change its float32 value by the sum of `exact`."""
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
                    total += term  # in the order of `exact`
                sums[unit, frame] = total


UNITS_AT_ONCE = 8  # units analysed in one batch: bounds the memory of a block of any length


class ReferenceTransform:
    """The reference form of one channel, continued from block to block.

    Vibration comes `latency_frames` after its sound, one unit (N). Use from one thread at a time.

    single: whether the caller rounds the result to float32. A faster method then gives equal
    values.
    """

    def __init__(
        self, parameters: TransformParameters, samplerate: int, *, single: bool = False
    ) -> None:
        self.samplerate = samplerate
        self._single = single
        self._spectrum = Spectrum.of(parameters, samplerate)
        self._finder = PrincipalFinder(parameters, self._spectrum.bin_hz, self._spectrum.bins)
        self._bandpass = BandPass(*design_band_pass(parameters, samplerate))
        self._mapping = VibrationMapping.of(parameters, parameters.unit_strength_hz(samplerate))
        self._superposition = Superposition(self._spectrum.window_frames, samplerate)
        self.latency_frames = self._spectrum.window_frames
        self.reset()

    def reset(self) -> None:
        """Return to the state of a new stream."""
        self._bandpass.reset()
        self._pending = np.zeros(0)
        self._ready = np.zeros(self.latency_frames)

    def process(self, mono: FloatArray) -> FloatArray:
        """Return the next (frames,) of vibration."""
        ready = np.concatenate((self._ready, self._render(self.cut(mono))))
        self._ready = ready[mono.size :]
        return ready[: mono.size]

    def finish(self) -> FloatArray:
        """Return the `latency_frames` still owed, and begin again."""
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
        vibration = np.empty(units.shape)
        for first in range(0, len(units), UNITS_AT_ONCE):
            batch = slice(first, first + UNITS_AT_ONCE)
            found = self.analyse(units[batch])
            vibration[batch] = self._superposed(found, len(units[batch]))
        return vibration.reshape(-1)

    def _superposed(self, found: Principals, units: int) -> FloatArray:
        """Return (units, N): each unit of equations (5)-(7), time from its own start."""
        edges = found.boundaries(units)
        hz = self._mapping.vibration_hz(found.audio_hz)
        weight = np.empty(len(found))
        for first, end in pairwise(edges):
            unit = slice(first, end)
            weight[unit] = self._mapping.amplitudes(found.amplitude[unit], found.r[unit])
        if self._single:
            return self._superposition.single(weight, hz, edges)
        return np.stack(
            [
                self._superposition.exact(weight[first:end], hz[first:end])
                for first, end in pairwise(edges)
            ]
        )


class ReferenceStream:
    """The reference form of each channel of a stream, of each source, or of the mono mix.

    transforms: one for each channel of vibration. channels: of the sound. weights: (channels,
    transforms, 2), of sources that are transformed instead of the channels; see `MonoMix`.
    `replaced_samples` counts unusable samples, which are taken for 0.
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
        self.delivered_frames = 0
        self.replaced_samples = 0
        self._transforms = transforms
        self._channels = channels
        halves = [downmix(channels)] if len(transforms) == 1 else []
        if weights is not None:
            halves = [weights[:, output] for output in range(len(transforms))]
        self._mixes = [MonoMix(half, transforms[0].samplerate) for half in halves]

    def process(self, frames: Frames) -> FloatArray:
        """Return (frames, transforms) of vibration for a block; raise as `fit_block`."""
        usable, replaced = replace_unusable(fit_block(frames, self._channels))
        self.replaced_samples += replaced
        self.delivered_frames += len(usable)
        rows = channel_rows(usable)
        mixed = [mix.process(rows) for mix in self._mixes] or rows
        each = zip(self._transforms, mixed, strict=True)
        return np.stack([one.process(sound) for one, sound in each], axis=1)

    def take_glides(self) -> FloatArray:
        """Return no rows: the reference form has no glides."""
        return np.empty((0, GLIDE_NUMBERS))

    def finish(self) -> FloatArray:
        """Return the last `latency_frames` of vibration, (frames, transforms), and restart."""
        self.delivered_frames += self.latency_frames
        rest = np.stack([one.finish() for one in self._transforms], axis=1)
        self.reset()
        return rest

    def reset(self) -> None:
        """Start a new stream; the counters keep their values."""
        for mix in self._mixes:
            mix.reset()
        for one in self._transforms:
            one.reset()
