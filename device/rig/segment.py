"""One segment of signal: the linear solution on it, what a model adds to it, and the crossfade."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from device.rig.actuator import QUANTITIES, SEAT_ACCELERATION
from device.units import FloatArray

_MIN_FADE_FRAMES = 16
"""A crossfade of fewer frames is not shortened any further."""
_JUMP_MARGIN = 1.25  # the old model may deviate by this multiple of the jump at the edge


@dataclass(frozen=True)
class Segment:
    """The linear solution on solid ground at each sample: (steps * spacing + 1,) each."""

    volts: FloatArray
    displacement_m: FloatArray
    velocity_m_s: FloatArray
    current_a: FloatArray
    acceleration_m_s2: FloatArray

    def part(self, start: int, stop: int) -> "Segment":
        """Return the samples from start to stop, both included."""
        return Segment(*(samples[start : stop + 1] for samples in vars(self).values()))

    def extend(self, samples: int, period_s: float) -> "Segment":
        """Return that many samples after the first; unknown ones are extrapolated smoothly."""
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
        return Segment(
            *(
                np.concatenate([known, known[-1] + more])
                for known, more in zip(vars(self).values(), on, strict=True)
            )
        )


class Correction:
    """What a model adds to the linear solution at the samples after the first, (frames,).

    Each quantity is computed only when it is asked for.
    """

    def __init__(
        self,
        end: FloatArray,
        samples: Mapping[str, Callable[[], FloatArray]],
        excursions_m: FloatArray,
    ) -> None:
        # d at the last node, (states,), and that of the path whose remainder was used
        self.end = self.under_end = end
        self.excursions_m = excursions_m  # total, at nodes or samples
        self.is_zero = False
        self._samples = samples

    def excursion_peaks_m(self, parts: int) -> list[float]:
        """Return the largest total excursion in each of several equal parts."""
        return [float(np.abs(part).max()) for part in np.array_split(self.excursions_m, parts)]

    def samples(self, quantity: str) -> FloatArray:
        """Return the values to add to a quantity of `Motion`."""
        return self._samples[quantity]()


def join_corrections(pieces: list[Correction]) -> Correction:
    """Return consecutive corrections as one."""

    def joined(name: str) -> FloatArray:
        return np.concatenate([piece.samples(name) for piece in pieces])

    samples = {name: partial(joined, name) for name in (*QUANTITIES, SEAT_ACCELERATION)}
    excursions_m = np.concatenate([piece.excursions_m for piece in pieces])
    return Correction(pieces[-1].end, samples, excursions_m)


def crossfade(
    values: FloatArray, old: FloatArray, base: FloatArray | None, allowed_share: float
) -> None:
    """Fade from the old model's correction to the new one's, in place.

    When the model changes, x, v and flux continue, but acceleration and current jump by the old
    model's error. So the old correction is continued past the edge and faded out. If it deviates
    by more than `allowed_share` of the total's peak, the fade is halved until it fits.

    The corrections are `values`, (frames,), and `old` for the first samples; `base` is the linear
    solution including the sample before, None for 0.
    """
    frames = len(old)
    apart = old - values[:frames]
    whole = values if base is None else values + base[1:]
    allowed = allowed_share * float(np.abs(whole).max())
    allowed = max(allowed, _JUMP_MARGIN * abs(float(apart[0])))
    while True:
        faded = apart[:frames] * _fade_weight(frames)
        if frames < _MIN_FADE_FRAMES or float(np.abs(faded).max()) <= allowed:
            break
        frames //= 2
    values[:frames] += faded


def _fade_weight(frames: int) -> FloatArray:
    """Return (frames,) from 1 to 0: the integral of a Hann window, -60 dB above 8 / T."""
    t = np.arange(1, frames + 1) / frames
    return np.asarray(1.0 - t + np.sin(2.0 * np.pi * t) / (2.0 * np.pi))
