"""What a rung adds to the linear solution, computed quantity by quantity when it is asked for."""

from collections.abc import Callable

import numpy as np

from device.rig.actuator import SEAT_ACCELERATION
from device.rig.linear_system import QUANTITIES
from device.units import FloatArray


class Correction:
    """What one rung adds to the linear solution, at the samples after the first, (frames,).

    end: d at the last node, (states,); under_end: that of the path whose remainder was taken,
    else the same. excursion_peak_m: of the sum, at nodes. is_nothing: all samples are 0.
    """

    def __init__(
        self, end: FloatArray, samples: dict[str, Callable[[], FloatArray]], peak_m: float
    ) -> None:
        self.end = self.under_end = end
        self.excursion_peak_m = peak_m
        self.is_nothing = False
        self._samples = samples

    def samples(self, quantity: str) -> FloatArray:
        """What to add to a quantity of `Motion`."""
        return self._samples[quantity]()


def held(values: FloatArray) -> Callable[[], FloatArray]:
    """Values that are there already."""
    return lambda: values


def joined(pieces: list[Correction]) -> Correction:
    """One stretch after the other as one."""

    def together(name: str) -> Callable[[], FloatArray]:
        return lambda: np.concatenate([piece.samples(name) for piece in pieces])

    return Correction(
        pieces[-1].end,
        {name: together(name) for name in (*QUANTITIES, SEAT_ACCELERATION)},
        max(piece.excursion_peak_m for piece in pieces),
    )
