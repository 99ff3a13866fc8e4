"""A stream of the reference form: the input stage, then one transform for each channel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from audioflinger_hook.core.compiled_core import GLIDE_NUMBERS
from audioflinger_hook.transform.arrays import FloatArray, Frames
from audioflinger_hook.transform.downmix import MonoMix
from audioflinger_hook.transform.input_stage import (
    Mixdown,
    channel_rows,
    fit_block,
    replace_unusable,
)
from audioflinger_hook.transform.reference.transform import ReferenceTransform
from device.layouts import downmix


class ChannelBank:
    """Transforms each channel separately, or the mono mix of the channels by one transform.

    transforms: one for each channel of vibration. channels: of the sound. mixdown: of the sources
    that are transformed instead of the channels. Counts as it goes: `delivered_frames`, and
    `replaced_samples` that were unusable and counted as 0.
    """

    told: tuple[tuple[float, float, float], ...] = ()
    limited_samples = 0

    def __init__(
        self,
        transforms: Sequence[ReferenceTransform],
        channels: int,
        mixdown: Mixdown | None = None,
    ) -> None:
        self.transforms = transforms
        self.mix = MonoMix(downmix(channels), transforms[0].samplerate)
        self.latency_frames = transforms[0].latency_frames
        self.tonal_latency_frames = transforms[0].tonal_latency_frames
        self.delivered_frames = 0
        self._replaced_samples = 0
        self._channels = channels
        self._mixdown = mixdown

    @property
    def replaced_samples(self) -> int:
        """Unusable samples so far, which counted as 0."""
        return self._mixdown.replaced_samples if self._mixdown else self._replaced_samples

    def process(self, frames: Frames) -> FloatArray:
        """Return (frames, transforms) of vibration for a block; raise as `fit_block`."""
        if self._mixdown:
            usable: Frames = self._mixdown.process(frames)
        else:
            usable, replaced = replace_unusable(fit_block(frames, self._channels))
            self._replaced_samples += replaced
        self.delivered_frames += len(usable)
        if len(self.transforms) == 1 and not self._mixdown:
            return self.transforms[0].process(self.mix.process(channel_rows(usable)))[:, None]
        return np.stack(
            [
                one.process(usable[:, channel].astype(np.float64))
                for channel, one in enumerate(self.transforms)
            ],
            axis=1,
        )

    def take_glides(self) -> FloatArray:
        """Return no rows: the reference form has no glides."""
        return np.empty((0, GLIDE_NUMBERS))

    def finish(self) -> FloatArray:
        """Return the last `latency_frames` of vibration, (frames, transforms), and restart."""
        self.delivered_frames += self.latency_frames
        self._reset_mixes()
        return np.stack([one.finish() for one in self.transforms], axis=1)

    def reset(self) -> None:
        """Start a new stream; the counters keep their values."""
        self._reset_mixes()
        for one in self.transforms:
            one.reset()

    def _reset_mixes(self) -> None:
        self.mix.reset()
        if self._mixdown:
            self._mixdown.reset()
