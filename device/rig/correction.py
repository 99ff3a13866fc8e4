"""What a rung adds to the linear solution, computed quantity by quantity when it is asked for."""

from collections.abc import Callable

import numpy as np

from device.rig.actuator import SEAT_ACCELERATION
from device.rig.linear_system import QUANTITIES
from device.units import FloatArray


class Correction:
    """What one rung adds to the linear solution, at the samples after the first, (frames,).

    end: d at the last node, (states,); under_end: that of the path whose remainder was taken,
    else the same. excursions_m: of the sum, at nodes or samples. is_nothing: all samples are 0.
    """

    def __init__(
        self,
        end: FloatArray,
        samples: dict[str, Callable[[], FloatArray]],
        excursions_m: FloatArray,
    ) -> None:
        self.end = self.under_end = end
        self.excursions_m = excursions_m
        self.is_nothing = False
        self._samples = samples

    @property
    def excursion_peak_m(self) -> float:
        """Of the sum."""
        return float(np.abs(self.excursions_m).max())

    def excursion_peaks_m(self, parts: int) -> list[float]:
        """Of the sum, in so many equal parts."""
        return [float(np.abs(part).max()) for part in np.array_split(self.excursions_m, parts)]

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
        np.concatenate([piece.excursions_m for piece in pieces]),
    )
