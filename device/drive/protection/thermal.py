"""How warm a coil is, and what power it may have without becoming too warm."""

import math

from device.rig.parameters import ThermalParameters
from device.rig.thermal import Temperatures

_APPROACH_S = 2.0
"""Time constant with which the limit is approached: heat that is left is spent at this pace."""


class CoilTemperature:
    """Coil and magnet of one actuator, from the room's temperature on. One thread calls it.

    resistance_ohm: of the coil at ambient_c; period_s: of a step.
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
        """R of the coil as warm as it is, ohm."""
        return self._temperatures.resistance_ohm(self._cold_ohm)

    def step(self, power_w: float) -> None:
        """Go on by one period with this mean power, W; it stays finite for any finite power."""
        self._temperatures.heat(power_w, self.period_s)

    def power_that_reaches(self, limit_c: float) -> float:
        """Mean power of the next period, W, at whose end the coil is at the limit; 0 or more."""
        now, step = self._temperatures, self._step
        left_k = limit_c - self.parameters.ambient_c
        left_k -= step.coil_by_coil * now.coil_k + step.coil_by_magnet * now.magnet_k
        return max(0.0, left_k / step.coil_by_power)

    def power_allowed(self, limit_c: float) -> float:
        """Mean power, W, with which the coil comes to the limit without ever passing it.

        What flows on to the magnet, and of the heat that the coil can still take e^-1 every 2 s.
        """
        onward_w = (self.coil_c - self.magnet_c) / self.parameters.coil_k_per_w
        left_j = self.parameters.coil_j_per_k * (limit_c - self.coil_c)
        return max(0.0, onward_w + left_j / _APPROACH_S)


def gain_for_power(allowed_w: float, wanted_w: float) -> float:
    """The gain, 0 to 1, that makes one power of another."""
    return 1.0 if wanted_w <= allowed_w else math.sqrt(allowed_w / wanted_w)
