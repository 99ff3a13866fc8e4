"""Coil and magnet as two thermal masses, and the coil's resistance at its temperature."""

import math

import numpy as np

from device.rig.parameters import ThermalParameters
from device.units import FloatArray

COPPER_PER_K = 0.00393  # relative rise of resistance per K, from 20 °C (IEC 60028)


class Temperatures:
    """Temperatures of coil and magnet above the surroundings, K. One thread calls it.

    Cc dTc/dt = P - (Tc - Tm) / Rc        Cm dTm/dt = (Tc - Tm) / Rc - Tm / Rm
    """

    def __init__(self, parameters: ThermalParameters) -> None:
        p = self.parameters = parameters
        into_magnet, out = 1.0 / p.coil_k_per_w, 1.0 / p.magnet_k_per_w
        self._rate = np.zeros((3, 3))
        self._rate[0] = np.array([-into_magnet, into_magnet, 1.0]) / p.coil_j_per_k
        self._rate[1, :2] = np.array([into_magnet, -(into_magnet + out)]) / p.magnet_j_per_k
        self._steps: dict[float, list[float]] = {}
        self.coil_k = self.magnet_k = 0.0

    def heat(self, power_w: float, duration_s: float) -> None:
        """Heat the coil with a constant power for a duration; the solution is exact."""
        # for a 2 x 2 system, floats are faster than arrays
        a, b, c, d, e, f = self.step(duration_s)
        coil_k, magnet_k = self.coil_k, self.magnet_k
        self.coil_k = a * coil_k + b * magnet_k + c * power_w
        self.magnet_k = d * coil_k + e * magnet_k + f * power_w

    def resistance_ohm(self, resistance_ohm: float) -> float:
        """Return the present resistance of a copper coil. resistance_ohm: at ambient_c."""
        ambient = 1.0 + COPPER_PER_K * (self.parameters.ambient_c - 20.0)
        return resistance_ohm * (1.0 + COPPER_PER_K * self.coil_k / ambient)

    def step(self, duration_s: float) -> list[float]:
        """Return the matrix from (coil_k, magnet_k, power_w) to (coil_k, magnet_k), row by row."""
        if duration_s not in self._steps:
            if len(self._steps) > 64:  # limits the memory for varying block lengths
                self._steps.clear()
            self._steps[duration_s] = _exponential(self._rate * duration_s)[:2].ravel().tolist()
        return self._steps[duration_s]


def _exponential(matrix: FloatArray) -> FloatArray:
    """Return the matrix exponential as a series; SciPy would load another library."""
    halvings = max(0, math.frexp(float(np.abs(matrix).sum(axis=1).max()))[1] + 1)
    part = np.ldexp(matrix, -halvings)
    term = found = np.eye(len(matrix))
    for order in range(1, 17):  # the omitted rest is under 1e-18
        term = term @ part / order
        found = found + term
    for _ in range(halvings):
        found = found @ found
    return found
