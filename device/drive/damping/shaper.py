"""Input shapers: the signal plus delayed copies of it, so that their free vibrations cancel.

Singer and Seering, "Preshaping command inputs to reduce system vibration", 1990. A pair of poles
with frequency f and Q answers an impulse by a vibration that is K = exp(-pi / sqrt(4 Q^2 - 1)) as
large and opposite half a damped period later. ZV adds a copy there; ZVD does so twice, which
makes the first derivative by f vanish too: less to lose where f is not known well.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from device.drive.damping.inverse import Resonance
from device.errors import UsageError
from device.units import FloatArray

ShaperKind = Literal["zv", "zvd"]


@dataclass(frozen=True)
class Impulses:
    """A shaper: amplitudes, which sum to 1, at delays_s."""

    delays_s: tuple[float, ...]
    amplitudes: tuple[float, ...]

    @property
    def latency_s(self) -> float:
        """How much later all that is slow arrives: the centroid of the impulses, s."""
        return sum(d * a for d, a in zip(self.delays_s, self.amplitudes, strict=True))

    def taps(self, samplerate: float) -> FloatArray:
        """(frames,): one amplitude a frame of delay; between frames divided by distance."""
        taps = np.zeros(math.floor(max(self.delays_s) * samplerate) + 2)
        for delay_s, amplitude in zip(self.delays_s, self.amplitudes, strict=True):
            frame, rest = divmod(delay_s * samplerate, 1.0)
            taps[int(frame)] += amplitude * (1.0 - rest)
            taps[int(frame) + 1] += amplitude * rest
        return np.trim_zeros(taps, "b")


def input_shaper(ringing: Resonance, kind: ShaperKind) -> Impulses:
    """The shaper of that kind; UsageError for a resonance that does not ring (Q of 0.5 or less)."""
    if ringing.q <= 0.5:
        raise UsageError(f"a resonance with Q {ringing.q:.2f} does not ring: no shaper is needed")
    root = math.sqrt(4.0 * ringing.q**2 - 1.0)
    half_s = ringing.q / (ringing.frequency_hz * root)  # half a damped period
    swing = math.exp(-math.pi / root)
    binomial = (1.0, swing) if kind == "zv" else (1.0, 2.0 * swing, swing**2)
    whole = sum(binomial)
    return Impulses(
        tuple(step * half_s for step in range(len(binomial))),
        tuple(share / whole for share in binomial),
    )
