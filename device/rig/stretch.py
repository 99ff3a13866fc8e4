"""A stretch of signal with the linear solution on it: what every rung of the ladder begins with."""

from dataclasses import dataclass

import numpy as np

from device.units import FloatArray


@dataclass(frozen=True)
class Stretch:
    """The linear solution on the ground at each sample of some whole steps: (steps * q + 1,)."""

    volts: FloatArray
    displacement_m: FloatArray
    velocity_m_s: FloatArray
    current_a: FloatArray
    acceleration_m_s2: FloatArray

    def part(self, start: int, stop: int) -> "Stretch":
        """Samples start to stop, the last one included."""
        return Stretch(*(samples[start : stop + 1] for samples in vars(self).values()))

    def extended(self, samples: int, period_s: float) -> "Stretch":
        """So many samples after the first, going on evenly where there are none yet, s apart."""
        ahead = np.arange(1, samples + 2 - len(self.volts))
        time_s = period_s * ahead
        w, (before, a) = self.velocity_m_s[-1], self.acceleration_m_s2[-2:]
        change = (a - before) / period_s
        on = (
            0.0 * time_s,
            w * time_s + a * time_s**2 / 2.0 + change * time_s**3 / 6.0,
            a * time_s + change * time_s**2 / 2.0,
            (self.current_a[-1] - self.current_a[-2]) * ahead,
            (a - before) * ahead,
        )
        return Stretch(
            *(
                np.concatenate([known, known[-1] + more])
                for known, more in zip(vars(self).values(), on, strict=True)
            )
        )
