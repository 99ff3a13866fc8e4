"""How warm a coil is, and how much power it may have."""

import math

from device.rig.parameters import ThermalParameters
from device.rig.thermal import Temperatures

_APPROACH_S = 2.0
"""Time constant of the approach to the limit."""


class CoilTemperature:
    """Coil and magnet of one actuator, which start at room temperature. One thread calls it.

    parameters: how they warm up.
    resistance_ohm: of the coil at room temperature.
    period_s: length of a step.
    """

    def __init__(
        self, parameters: ThermalParameters, resistance_ohm: float, period_s: float
    ) -> None:
        self.parameters = parameters
        self.period_s = period_s
        self._cold_ohm = resistance_ohm
        self._temperatures = Temperatures(parameters)
        self._step = self._temperatures.step(period_s)

    def reset(self) -> None:
        """Cool down to the room."""
        self._temperatures.reset()

    @property
    def coil_c(self) -> float:
        """Temperature of the coil, degrees C."""
        return self.parameters.ambient_c + self._temperatures.coil_k

    @property
    def magnet_c(self) -> float:
        """Temperature of the magnet, degrees C."""
        return self.parameters.ambient_c + self._temperatures.magnet_k

    @property
    def resistance_ohm(self) -> float:
        """Resistance of the coil at its present temperature, ohm."""
        return self._temperatures.resistance_ohm(self._cold_ohm)

    def step(self, power_w: float) -> None:
        """Advance by one period with this mean power, W."""
        self._temperatures.heat(power_w, self.period_s)

    def power_that_reaches(self, limit_c: float) -> float:
        """Return the mean power, W, that takes the coil to the limit within the next period."""
        now, step = self._temperatures, self._step
        left_k = limit_c - self.parameters.ambient_c
        left_k -= step.coil_by_coil * now.coil_k + step.coil_by_magnet * now.magnet_k
        return max(0.0, left_k / step.coil_by_power)

    def power_allowed(self, limit_c: float) -> float:
        """Return the mean power, W, that approaches the limit without passing it.

        It is what flows to the magnet, plus the coil's remaining heat capacity over 2 s.
        """
        onward_w = (self.coil_c - self.magnet_c) / self.parameters.coil_k_per_w
        left_j = self.parameters.coil_j_per_k * (limit_c - self.coil_c)
        return max(0.0, onward_w + left_j / _APPROACH_S)


def gain_for_power(allowed_w: float, wanted_w: float) -> float:
    """Return the gain, 0 to 1, that reduces the wanted power to the allowed one."""
    return 1.0 if wanted_w <= allowed_w else math.sqrt(allowed_w / wanted_w)
