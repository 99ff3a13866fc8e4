"""State that must outlive a process: temperatures of coil and magnet, and exposure of the day."""

import math
from dataclasses import dataclass, replace

from device.drive.exposure import DoseSums
from device.drive.protection.design import APPROACH_S, limits_of
from device.rig import Rig
from device.rig.thermal import Temperatures

NO_DOSE = DoseSums()
LONGEST_REST_S = 10 * 365 * 86_400.0  # a longer time is an error of a clock
_STEP_S = 0.01  # time step, much shorter than `APPROACH_S`


@dataclass(frozen=True)
class SafetyState:
    """Stored state of one actuator. Temperatures in °C; None if the rig has no [thermal]."""

    coil_c: float | None = None
    magnet_c: float | None = None
    dose: DoseSums = NO_DOSE


class SafetyBounds:
    """Upper bounds on temperatures and dose. worst_s: upper bound on the dose of one second."""

    def __init__(self, rig: Rig, worst_s: DoseSums) -> None:
        self._rig, self._worst_s = rig, worst_s
        amplifier = rig.amplifier
        volts = min(rig.dac.full_scale_v * amplifier.gain, amplifier.output_limit_v)
        ohm = rig.actuator.resistance_ohm
        self._limit_c = limits_of(rig).coil_temperature_c
        self._most_w = min(volts**2 / ohm, amplifier.current_limit_a**2 * ohm)

    @property
    def warmest(self) -> SafetyState:
        """The state after a long time at the temperature limit, with a dose of 0."""
        thermal, limit_c = self._rig.thermal, self._limit_c
        if thermal is None or limit_c is None:
            return SafetyState()
        share = thermal.magnet_k_per_w / (thermal.coil_k_per_w + thermal.magnet_k_per_w)
        return SafetyState(limit_c, thermal.ambient_c + share * (limit_c - thermal.ambient_c))

    def after_unrecorded(self, state: SafetyState, seconds: float) -> SafetyState:
        """Return the worst possible state after `seconds` of any vibration with protection."""
        seconds = max(0.0, seconds)
        dose = state.dose.plus(self._worst_s, seconds)
        return replace(self._heated(state, seconds, self._most_w), dose=dose)

    def after_rest(self, state: SafetyState, seconds: float) -> SafetyState:
        """Return the state after `seconds` without vibration."""
        return self._heated(state, max(0.0, seconds), 0.0)

    def _heated(self, state: SafetyState, seconds: float, most_w: float) -> SafetyState:
        thermal, limit_c = self._rig.thermal, self._limit_c
        if thermal is None or limit_c is None:
            return replace(state, coil_c=None, magnet_c=None)
        known = self.warmest if state.coil_c is None or state.magnet_c is None else state
        assert known.coil_c is not None
        assert known.magnet_c is not None
        warm, ambient_c = Temperatures(thermal), thermal.ambient_c
        # Coil and magnet are never colder than the surroundings.
        warm.coil_k = max(0.0, known.coil_c - ambient_c)
        warm.magnet_k = max(0.0, known.magnet_c - ambient_c)
        count = max(1, math.ceil(min(seconds, 60.0) / _STEP_S)) if most_w else 1
        for _ in range(count if seconds else 0):
            warm.heat(min(most_w, power_to_limit_w(warm, limit_c - ambient_c)), seconds / count)
        # A finite time step may exceed the temperature limit slightly.
        coil_c = min(ambient_c + warm.coil_k, max(limit_c, known.coil_c))
        return replace(state, coil_c=coil_c, magnet_c=ambient_c + warm.magnet_k)


def power_to_limit_w(warm: Temperatures, limit_k: float) -> float:
    """Return the power in W with which the coil approaches limit_k, in K above the surroundings.

    It is the heat flow to the magnet, plus the coil's spare heat divided by `APPROACH_S`.
    """
    thermal = warm.parameters
    onward_w = (warm.coil_k - warm.magnet_k) / thermal.coil_k_per_w
    return max(0.0, onward_w + thermal.coil_j_per_k * (limit_k - warm.coil_k) / APPROACH_S)
