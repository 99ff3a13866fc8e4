"""A stream in NumPy: intake, then one transform for each channel of vibration.

Hops begin with the sound: where it comes after silence, its first frame is the first of a hop. The
same sound so gives the same vibration however long the silence before it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, Frames
from audioflinger_hook.transform.input_stage import fitting, mono, replace_unusable
from audioflinger_hook.transform.live.loudness import LoudnessFollower


class MonoTransform(Protocol):
    """One channel of either form."""

    latency_frames: int
    tonal_latency_frames: int
    limited_frames: int
    onset_after_frames: int
    """Frames of silence after which sound is an onset; 0 where hops never move."""

    @property
    def follower(self) -> LoudnessFollower | None:
        """Of loudness, None where it is not followed."""
        ...

    @property
    def frames_to_hop(self) -> int:
        """Frames that the hop under way still lacks, the same for all voices."""
        ...

    @property
    def asleep(self) -> bool:
        """Whether nothing is played, and what was heard has no effect any more."""
        ...

    def begin_hop(self) -> None:
        """Let the next frame be the first of a hop; while it is asleep only."""
        ...

    def process(self, mono: FloatArray) -> FloatArray:
        """Return as many frames as come in, `latency_frames` behind them."""
        ...

    def finish(self) -> FloatArray:
        """Return the `latency_frames` still owed, and begin anew."""
        ...

    def reset(self) -> None:
        """Begin anew."""
        ...


class ChannelBank:
    """Every channel through a voice of its own, or with one voice their mean.

    channels: of the sound. Counts as it goes: `delivered_frames`, `replaced_samples` that were
    unusable and taken for 0, `limited_samples` of vibration that the limiter has changed.
    """

    def __init__(self, voices: Sequence[MonoTransform], channels: int) -> None:
        self.voices = voices
        self.latency_frames = voices[0].latency_frames
        self.tonal_latency_frames = voices[0].tonal_latency_frames
        self.delivered_frames = 0
        self.replaced_samples = 0
        self._channels = channels
        self._onset_after = voices[0].onset_after_frames
        self._silent_frames = self._onset_after
        self._followers = [voice.follower for voice in voices if voice.follower]

    @property
    def limited_samples(self) -> int:
        """Samples of vibration that the limiter has changed, some not delivered yet."""
        return sum(voice.limited_frames for voice in self.voices)

    def process(self, frames: Frames) -> FloatArray:
        """Return (frames, voices) of vibration for sound that `fitting` takes, or raise as it."""
        frames = fitting(frames, self._channels)
        usable, replaced = replace_unusable(frames)
        self.replaced_samples += replaced
        self.delivered_frames += len(frames)
        if not self._onset_after:
            return self._through(usable)
        parts, first = [], 0
        for onset in self._onsets(frames):
            parts.append(self._through(usable[first:onset]))
            first = onset
            if all(voice.asleep for voice in self.voices):
                for voice in self.voices:
                    voice.begin_hop()
        parts.append(self._through(usable[first:]))
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _through(self, usable: Frames) -> FloatArray:
        if len(self.voices) == 1:
            return self.voices[0].process(mono(usable))[:, None]
        if not self._followers:
            return self._each(usable)
        parts = [np.zeros((0, len(self.voices)))]
        while len(usable):
            frames = self.voices[0].frames_to_hop
            parts.append(self._each(usable[:frames]))
            usable = usable[frames:]
            self._share_programme()
        return np.concatenate(parts)

    def _share_programme(self) -> None:
        """Let the loudest programme be that of all: what is softer on one side stays so."""
        loudest_db = max(follower.programme_db for follower in self._followers)
        for follower in self._followers:
            follower.programme_db = loudest_db

    def _each(self, usable: Frames) -> FloatArray:
        return np.stack(
            [
                voice.process(usable[:, channel].astype(np.float64))
                for channel, voice in enumerate(self.voices)
            ],
            axis=1,
        )

    def _onsets(self, frames: Frames) -> list[int]:
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
        """Return the last `latency_frames` of vibration, (frames, voices), and begin anew."""
        self.delivered_frames += self.latency_frames
        self._silent_frames = self._onset_after
        if len(self._followers) > 1:
            # Together: the last hops of one voice count for all.
            owed = self._through(np.zeros((self.latency_frames, self._channels)))
            for voice in self.voices:
                voice.reset()
            return owed
        return np.stack([voice.finish() for voice in self.voices], axis=1)

    def reset(self) -> None:
        """Begin a new stream; the counters go on."""
        self._silent_frames = self._onset_after
        for voice in self.voices:
            voice.reset()
