"""State that must outlive a process: how warm coil and magnet are, and the dose of the day."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from device.drive.exposure.dose import DoseSums
from device.drive.protection.limits import limits_of
from device.drive.protection.thermal import CoilTemperature
from device.rig import Rig

_STEP_S = 0.01
"""Step in which the protection's law of power is followed; it changes over 2 s."""


NO_DOSE = DoseSums()


@dataclass(frozen=True)
class SafetyState:
    """What one actuator must not forget. Temperatures in °C; None if the rig has no [thermal]."""

    coil_c: float | None = None
    magnet_c: float | None = None
    dose: DoseSums = NO_DOSE


class SafetyBounds:
    """The worst that a protected actuator can have done in a time that nobody recorded. Pure.

    rig: of the actuator. worst_s: the dose of a second of the strongest drive.
    """

    def __init__(self, rig: Rig, worst_s: DoseSums) -> None:
        self._rig = rig
        self._worst_s = worst_s
        amplifier = rig.amplifier
        volts = min(rig.dac.full_scale_v * amplifier.gain, amplifier.output_limit_v)
        ohm = rig.actuator.resistance_ohm
        self._limit_c = limits_of(rig).coil_temperature_c
        self._most_w = min(volts**2 / ohm, amplifier.current_limit_a**2 * ohm)

    @property
    def warmest(self) -> SafetyState:
        """The state of an actuator that has been at its limit for long, without a dose."""
        thermal, limit_c = self._rig.thermal, self._limit_c
        if thermal is None or limit_c is None:
            return SafetyState()
        share = thermal.magnet_k_per_w / (thermal.coil_k_per_w + thermal.magnet_k_per_w)
        magnet_c = thermal.ambient_c + share * (limit_c - thermal.ambient_c)
        return SafetyState(limit_c, magnet_c)

    def after_unrecorded(self, state: SafetyState, seconds: float) -> SafetyState:
        """Return the worst state after so many unrecorded seconds under protection."""
        seconds = max(0.0, seconds)
        worst = self._worst_s
        added = DoseSums(
            seconds, worst.squares * seconds, worst.fourths * seconds, worst.high * seconds
        )
        return replace(self._heated(state, seconds, self._most_w), dose=state.dose.plus(added))

    def after_rest(self, state: SafetyState, seconds: float) -> SafetyState:
        """Return the state after so many seconds without any drive."""
        return self._heated(state, max(0.0, seconds), 0.0)

    def _heated(self, state: SafetyState, seconds: float, most_w: float) -> SafetyState:
        thermal, limit_c = self._rig.thermal, self._limit_c
        if thermal is None or limit_c is None:
            return replace(state, coil_c=None, magnet_c=None)
        known = self.warmest if state.coil_c is None or state.magnet_c is None else state
        assert known.coil_c is not None
        assert known.magnet_c is not None
        count = max(1, math.ceil(min(seconds, 60.0) / _STEP_S)) if most_w else 1
        coil = CoilTemperature(thermal, self._rig.actuator.resistance_ohm, seconds / count)
        coil.set_temperatures(known.coil_c, known.magnet_c)
        for _ in range(count if seconds else 0):
            coil.step(min(most_w, coil.power_allowed(limit_c)) if most_w else 0.0)
        # A step may end microkelvins above what protection holds.
        coil_c = min(coil.coil_c, max(limit_c, known.coil_c))
        return replace(state, coil_c=coil_c, magnet_c=coil.magnet_c)
