"""The oscillator bank: glides of frequency and amplitude to samples at the low rate."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.partials import Glides

ATTACK_HOPS = 0.35
"""Share of a hop in which amplitudes glide where their sum rises: an onset is felt 5 ms earlier
than with a whole one, and the low-pass still keeps what leaks above 250 Hz under -58 dB. Where
the sum falls they take the whole hop."""


STILL = 1e-9
"""A sum of amplitudes rises from here on: rounding must not choose between the two shapes."""


class OscillatorBank:
    """Samples of gliding partials; pure, holds only the shape of a glide.

    Glides follow half a cosine period, u = (1 - cos(pi t))/2: no kink at either end, so a birth
    or a death leaks least. Phase is the integral of frequency and therefore continuous.
    """

    delay_hops = 0.5 + (ATTACK_HOPS + 1.0) / 4.0
    """How late an amplitude follows its analysis: half a hop held, and half a glide on average."""

    def __init__(self, steps: int, hop_s: float, attack: float = ATTACK_HOPS) -> None:
        time = np.arange(1, steps + 1) / steps
        self._steps = steps
        self._glide = 0.5 - 0.5 * np.cos(np.pi * time)
        self._attack = 0.5 - 0.5 * np.cos(np.pi * np.minimum(1.0, time / attack))
        turns = 2.0 * np.pi * hop_s
        self._turn = turns * time
        self._turn_glide = turns * (0.5 * time - np.sin(np.pi * time) / (2.0 * np.pi))

    def render(self, glides: Glides) -> FloatArray:
        """Return (hops, steps) of the summed partials, full scale.

        Slots are added one after another, so a slot at amplitude 0 changes no byte and is left
        out where it is silent in the whole batch.
        """
        rise = glides.end_amplitude - glides.start_amplitude
        loudest = np.maximum(glides.start_amplitude, glides.end_amplitude).max(axis=0)
        slots = loudest.nonzero()[0]

        def of_slots(values: FloatArray) -> FloatArray:
            chosen: FloatArray = values.take(slots, axis=1).T[:, :, None]
            return chosen

        start_hz = of_slots(glides.start_hz)
        phase = start_hz * self._turn
        phase += (of_slots(glides.end_hz) - start_hz) * self._turn_glide
        phase += (2.0 * np.pi) * of_slots(glides.start_phase)
        partials = np.cos(phase, out=phase)
        # One shape for all slots of a hop: then their sum never exceeds both its ends, which is
        # what keeps the wave under full scale.
        rising = np.add.reduce(rise, axis=1) > STILL
        shape = np.where(rising[:, None], self._attack, self._glide)
        level = of_slots(rise) * shape
        level += of_slots(glides.start_amplitude)
        partials *= level
        total: FloatArray = np.add.reduce(partials, axis=0)
        return total
