"""Sound mixed for voices, each to be transformed by itself: weighted sums of its channels."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, Frames
from audioflinger_hook.transform.intake import fitting, replace_unusable


class Mixdown:
    """Sound of some channels as sound of some voices.

    weights: (channels, voices). Unusable samples count as 0 before they are mixed, and in
    `replaced_samples`. Held by one thread at a time.
    """

    def __init__(self, weights: FloatArray) -> None:
        self.channels, self.voices = weights.shape
        self.replaced_samples = 0
        self._routes = [
            (int(channel), int(voice), float(weights[channel, voice]))
            for channel, voice in np.argwhere(weights)
        ]

    def process(self, frames: Frames) -> FloatArray:
        """Return (frames, voices) float64 for sound that `fitting` takes, or raise as it.

        Channels are added one by one: the sum must not depend on the block's shape.
        """
        usable, replaced = replace_unusable(fitting(frames, self.channels))
        self.replaced_samples += replaced
        # Channels as rows: each is one stretch of memory.
        rows = np.asarray(usable.T, np.float64, order="C")
        mixed, weighted = np.zeros((self.voices, len(usable))), np.empty(len(usable))
        for channel, voice, weight in self._routes:
            mixed[voice] += np.multiply(rows[channel], weight, out=weighted)
        return np.ascontiguousarray(mixed.T)
