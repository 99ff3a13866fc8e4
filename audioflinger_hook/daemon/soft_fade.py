"""A fade of the played vibration between silence and full level, shaped sample by sample."""

from __future__ import annotations

import numpy as np

from device.units import Float32Array

FADE_S = 0.04
"""Length of a fade, as in the plugin. At full scale it leaves -59 dB above 250 Hz of 50 Hz."""


class SoftFade:
    """A factor for the output, which moves to 0 or 1 without a bend at either end.

    The output's thread calls `apply`; any thread may set `audible` and read the rest.

    audible: what the factor moves to. position: 0 while silent, 1 at full level.
    """

    def __init__(self, samplerate: int, *, audible: bool = True) -> None:
        self.audible = audible
        self.position = 1.0 if audible else 0.0
        self._step = 1.0 / (FADE_S * samplerate)

    def apply(self, out: Float32Array) -> None:
        """Multiply the next frames; at full level they stay the same, bit for bit."""
        wanted = 1.0 if self.audible else 0.0
        if self.position == wanted:
            if not wanted:
                out[:] = 0.0
            return
        step = self._step if wanted else -self._step
        places = self.position + step * np.arange(1, len(out) + 1)
        places = np.clip(places, 0.0, 1.0, out=places)
        out *= (places * places * (3.0 - 2.0 * places))[:, None]
        if len(out):
            self.position = float(places[-1])
