"""How warm a coil is, and how much power it may have."""

from device.rig.parameters import ThermalParameters
from device.rig.thermal import Temperatures

APPROACH_S = 2.0
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

    def reset(self) -> None:
        """Cool down to the room."""
        self._temperatures.reset()

    def set_temperatures(self, coil_c: float, magnet_c: float) -> None:
        """Continue with these temperatures, degrees C; none is colder than the room."""
        room_c = self.parameters.ambient_c
        self._temperatures.coil_k = max(0.0, coil_c - room_c)
        self._temperatures.magnet_k = max(0.0, magnet_c - room_c)

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

    def power_allowed(self, limit_c: float) -> float:
        """Return the mean power, W, that approaches the limit without passing it.

        It is what flows to the magnet, plus the coil's remaining heat capacity over 2 s.
        """
        onward_w = (self.coil_c - self.magnet_c) / self.parameters.coil_k_per_w
        left_j = self.parameters.coil_j_per_k * (limit_c - self.coil_c)
        return max(0.0, onward_w + left_j / APPROACH_S)
