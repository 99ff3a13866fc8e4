"""A stream in NumPy: intake, then one transform for each channel of vibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, Frames
from audioflinger_hook.transform.intake import fitting, mono, replace_unusable


class MonoTransform(Protocol):
    """One channel of either form."""

    latency_frames: int
    limited_frames: int

    def process(self, mono: FloatArray) -> FloatArray:
        """Return as many frames as come in, `latency_frames` behind them."""
        ...

    def finish(self) -> FloatArray:
        """Return the `latency_frames` still owed, and begin anew."""
        ...

    def reset(self) -> None:
        """Begin anew."""
        ...


class VoiceStream:
    """Every channel through a voice of its own, or with one voice their mean.

    channels: of the sound. Counts as it goes: `delivered_frames`, `replaced_samples` that were
    unusable and taken for 0, `limited_samples` of vibration that the limiter has changed.
    """

    def __init__(self, voices: Sequence[MonoTransform], channels: int) -> None:
        self.voices = voices
        self.latency_frames = voices[0].latency_frames
        self.delivered_frames = 0
        self.replaced_samples = 0
        self._channels = channels

    @property
    def limited_samples(self) -> int:
        """Samples of vibration that the limiter has changed, some not delivered yet."""
        return sum(voice.limited_frames for voice in self.voices)

    def process(self, frames: Frames) -> FloatArray:
        """Return (frames, voices) of vibration for sound that `fitting` takes, or raise as it."""
        usable, replaced = replace_unusable(fitting(frames, self._channels))
        self.replaced_samples += replaced
        self.delivered_frames += len(frames)
        if len(self.voices) == 1:
            return self.voices[0].process(mono(usable))[:, None]
        return np.stack(
            [
                voice.process(usable[:, channel].astype(np.float64))
                for channel, voice in enumerate(self.voices)
            ],
            axis=1,
        )

    def finish(self) -> FloatArray:
        """Return the last `latency_frames` of vibration, (frames, voices), and begin anew."""
        self.delivered_frames += self.latency_frames
        return np.stack([voice.finish() for voice in self.voices], axis=1)

    def reset(self) -> None:
        """Begin a new stream; the counters go on."""
        for voice in self.voices:
            voice.reset()
