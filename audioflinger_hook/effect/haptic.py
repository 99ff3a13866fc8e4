"""The haptic effect: reads the mix, leaves it as it is, and gives the vibration beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.settings import Settings
from audioflinger_hook.transform import HapticTransform
from audioflinger_hook.transform.arrays import Frames


class HapticEffect:
    """One instance of the effect on one stream.

    samplerate: Hz; channels: of the sound. Its output has `haptic_channels` channels and comes
    `latency_frames` after the sound. Held by the thread that steps the chain.
    """

    def __init__(self, samplerate: int, channels: int, settings: Settings) -> None:
        self._transform = HapticTransform(
            samplerate,
            channels,
            settings.parameters,
            form=settings.form,
            per_channel=settings.channels == "each",
        )
        self.samplerate = samplerate
        self.haptic_channels = self._transform.channels_out
        self.latency_frames = self._transform.latency_frames

    @property
    def latency_s(self) -> float:
        """The latency in seconds."""
        return self._transform.latency_s

    @property
    def limited_samples(self) -> int:
        """Samples of vibration that the limiter has changed so far."""
        return self._transform.limited_samples

    @property
    def replaced_samples(self) -> int:
        """Unusable samples of sound that were taken for 0 so far."""
        return self._transform.replaced_samples

    def process(self, audio: Frames) -> NDArray[np.float32]:
        """Return the vibration due, (frames, haptic_channels) float32; audio is only read."""
        return self._transform.process(audio).astype(np.float32)

    def finish(self) -> NDArray[np.float32]:
        """Return the `latency_frames` that are still owed when the sound has ended."""
        return self._transform.finish().astype(np.float32)
