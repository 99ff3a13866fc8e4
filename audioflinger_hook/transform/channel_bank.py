"""A stream in NumPy: the input stage, then one transform for each channel of vibration.

Hops begin with the sound, so that silence before it changes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, Frames
from audioflinger_hook.transform.downmix import MonoMix
from audioflinger_hook.transform.input_stage import channel_rows, fit_block, replace_unusable
from audioflinger_hook.transform.live.synthesis import GLIDE_COLUMNS
from audioflinger_hook.transform.live.transform import LiveTransform
from audioflinger_hook.transform.reference.transform import ReferenceTransform
from device.layouts import downmix

TOLD_MAX = 16
"""Largest number of partials that are reported, as in the kernel."""


class ChannelBank:
    """Transforms each channel separately, or the mono mix of the channels by one transform.

    transforms: one for each channel of vibration. channels: of the sound. Counts as it goes:
    `delivered_frames`, and `replaced_samples` that were unusable and counted as 0.
    """

    def __init__(
        self, transforms: Sequence[LiveTransform | ReferenceTransform], channels: int
    ) -> None:
        self.transforms = transforms
        self.mix = MonoMix(downmix(channels), transforms[0].samplerate)
        self.latency_frames = transforms[0].latency_frames
        self.tonal_latency_frames = transforms[0].tonal_latency_frames
        self.delivered_frames = 0
        self.replaced_samples = 0
        self._channels = channels
        self._onset_after = transforms[0].onset_after_frames
        self._silent_frames = self._onset_after
        self._followers = [one.follower for one in transforms if one.follower]

    @property
    def limited_samples(self) -> int:
        """Samples of vibration that the limiter has changed, some not delivered yet."""
        return sum(one.limited_frames for one in self.transforms)

    @property
    def told(self) -> tuple[tuple[float, float, float], ...]:
        """What the latest hop of all channels vibrates, at most 16; () of the reference form."""
        told = [one for each in self.transforms for one in getattr(each, "told", ())]
        if len(told) > TOLD_MAX:
            told = sorted(told, key=lambda one: one[2])[-TOLD_MAX:]
        return tuple(told)

    def take_glides(self) -> FloatArray:
        """Return what all partials did since the last call; see `HapticTransform.take_glides`."""
        found = [
            rows
            for voice, one in enumerate(self.transforms)
            if isinstance(one, LiveTransform)
            for rows in one.take_glides(voice)
        ]
        return np.array(found).reshape(-1, len(GLIDE_COLUMNS))

    def process(self, frames: Frames) -> FloatArray:
        """Return (frames, transforms) of vibration for a block; raise as `fit_block`."""
        frames = fit_block(frames, self._channels)
        usable, replaced = replace_unusable(frames)
        self.replaced_samples += replaced
        self.delivered_frames += len(frames)
        if not self._onset_after:
            return self._transform(usable)
        parts, first = [], 0
        for onset in self._find_onsets(frames):
            parts.append(self._transform(usable[first:onset]))
            first = onset
            if all(one.asleep for one in self.transforms):
                self.mix.reset()
                for one in self.transforms:
                    one.begin_hop()
        parts.append(self._transform(usable[first:]))
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _transform(self, usable: Frames) -> FloatArray:
        if len(self.transforms) == 1:
            return self.transforms[0].process(self.mix.process(channel_rows(usable)))[:, None]
        if not self._followers:
            return self._transform_each(usable)
        parts = [np.zeros((0, len(self.transforms)))]
        while len(usable):
            frames = self.transforms[0].frames_to_hop
            parts.append(self._transform_each(usable[:frames]))
            usable = usable[frames:]
            self._share_programme()
        return np.concatenate(parts)

    def _share_programme(self) -> None:
        """Use the loudest programme level for all: the softer side of a sound stays softer."""
        loudest_db = max(follower.programme_db for follower in self._followers)
        for follower in self._followers:
            follower.programme_db = loudest_db

    def _transform_each(self, usable: Frames) -> FloatArray:
        return np.stack(
            [
                one.process(usable[:, channel].astype(np.float64))
                for channel, one in enumerate(self.transforms)
            ],
            axis=1,
        )

    def _find_onsets(self, frames: Frames) -> list[int]:
        """Return the frames that are the first not to be exactly 0 after silence; count that."""
        loud = (frames != 0.0).any(axis=1).nonzero()[0]
        if not loud.size:
            self._silent_frames = min(self._onset_after, self._silent_frames + len(frames))
            return []
        silent = np.diff(loud, prepend=-1) - 1
        silent[0] += self._silent_frames
        self._silent_frames = min(self._onset_after, len(frames) - 1 - int(loud[-1]))
        return [int(onset) for onset in loud[silent >= self._onset_after]]

    def finish(self) -> FloatArray:
        """Return the last `latency_frames` of vibration, (frames, transforms), and restart."""
        self.delivered_frames += self.latency_frames
        self._silent_frames = self._onset_after
        self.mix.reset()
        if len(self._followers) > 1:
            # Together: the last hops of one channel count for all.
            rest = self._transform(np.zeros((self.latency_frames, self._channels)))
            for one in self.transforms:
                one.reset()
            return rest
        return np.stack([one.finish() for one in self.transforms], axis=1)

    def reset(self) -> None:
        """Start a new stream; the counters keep their values."""
        self._silent_frames = self._onset_after
        self.mix.reset()
        for one in self.transforms:
            one.reset()
