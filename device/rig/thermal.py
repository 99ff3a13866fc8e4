"""Coil and magnet as two thermal masses, and the resistance that follows from the coil's warmth."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from device.rig.parameters import ThermalParameters

COPPER_PER_K = 0.00393
"""Rise of copper's resistance, as a share of that at 20 degrees Celsius, per kelvin (IEC 60028)."""


class ThermalStep(NamedTuple):
    """What coil and magnet have after a duration, K: of either before it, K, and of a power, W."""

    coil_by_coil: float
    coil_by_magnet: float
    coil_by_power: float
    magnet_by_coil: float
    magnet_by_magnet: float
    magnet_by_power: float


class Temperatures:
    """Coil and magnet above their surroundings, K. One thread calls it.

        Cc dTc/dt = P - (Tc - Tm) / Rc        Cm dTm/dt = (Tc - Tm) / Rc - Tm / Rm

    coil_k, magnet_k: 0 in the beginning.
    """

    def __init__(self, parameters: ThermalParameters) -> None:
        p = self.parameters = parameters
        into_magnet = 1.0 / p.coil_k_per_w
        out = 1.0 / p.magnet_k_per_w
        self._rate = np.zeros((3, 3))
        self._rate[0] = [-into_magnet, into_magnet, 1.0]
        self._rate[0] /= p.coil_j_per_k
        self._rate[1, :2] = [into_magnet, -(into_magnet + out)]
        self._rate[1] /= p.magnet_j_per_k
        self._steps: dict[float, ThermalStep] = {}
        self.reset()

    def reset(self) -> None:
        """Cool down."""
        self.coil_k = 0.0
        self.magnet_k = 0.0

    def heat(self, power_w: float, duration_s: float) -> None:
        """Exact for a power in the coil, W, that is constant over the duration, s."""
        step, coil_k, magnet_k = self.step(duration_s), self.coil_k, self.magnet_k
        self.coil_k = step.coil_by_coil * coil_k + step.coil_by_magnet * magnet_k
        self.coil_k += step.coil_by_power * power_w
        self.magnet_k = step.magnet_by_coil * coil_k + step.magnet_by_magnet * magnet_k
        self.magnet_k += step.magnet_by_power * power_w

    def resistance_ohm(self, resistance_ohm: float) -> float:
        """What a copper coil of that resistance at ambient_c has now."""
        ambient = 1.0 + COPPER_PER_K * (self.parameters.ambient_c - 20.0)
        return resistance_ohm * (1.0 + COPPER_PER_K * self.coil_k / ambient)

    def step(self, duration_s: float) -> ThermalStep:
        """The step of a duration, s; those asked for lately are kept."""
        if duration_s not in self._steps:
            if len(self._steps) > 64:  # blocks of ever other lengths must not fill the memory
                self._steps.clear()
            # Plain floats: two by two is faster without arrays.
            entries = expm(self._rate * duration_s)[:2].ravel().tolist()
            self._steps[duration_s] = ThermalStep(*entries)
        return self._steps[duration_s]
