"""What the core says of the actuators that drive one rig."""

from __future__ import annotations

from collections.abc import Sequence

from audioflinger_hook.core.structures import LIMITED_BY, Controls, Readings
from device.drive.design import DriveDesign
from device.drive.exposure import DoseSums, Exposure
from device.drive.protection import ProtectionStatus
from device.drive.safety import SafetyState
from device.units import amplitude_to_db


class DrivenRig:
    """Readings of the core's actuators in `slots`, which drive one rig. Any thread."""

    def __init__(
        self, design: DriveDesign, controls: Controls, readings: Readings, slots: range
    ) -> None:
        self.design, self.rig, self.exposure_cap = design, design.rig, design.exposure_cap
        self.knows_seat, self.makeup_db = design.knows_seat, design.makeup_db
        self.latency_frames = design.latency_frames
        self.channels = len(slots)
        self._core_controls, self._core_readings = controls, readings
        self._day_began_at = -1
        self._controls = controls.actuators[slots.start : slots.stop]
        self._readings = readings.actuators[slots.start : slots.stop]

    @property
    def has_run(self) -> bool:
        """Whether the core has processed anything."""
        return bool(self._core_readings.frames)

    def protection(self) -> ProtectionStatus:
        """Return counts, and the readings of the worst channel."""
        found = self._readings
        worst = min(found, key=lambda one: one.gain)
        coil_c = max(state.coil_c or 0.0 for state in self.safety_states())
        return ProtectionStatus(
            blocks=max(one.blocks for one in found),
            limited_blocks=max(one.limited_blocks for one in found),
            infeasible_blocks=sum(one.infeasible_blocks for one in found),
            replaced_samples=sum(one.replaced for one in found),
            gain=worst.gain if self.has_run else 1.0,
            least_gain=min(one.least_gain for one in found) if self.has_run else 1.0,
            limited_by=LIMITED_BY[min(worst.limited_by, len(LIMITED_BY) - 1)],
            excursion_m=max(one.excursion_m for one in found),
            coil_c=coil_c if self.rig.thermal else None,
            resistance_ohm=self.design.resistance_ohm(coil_c) if self.rig.thermal else None,
            latency_s=self.latency_frames / self.design.samplerate,
        )

    def exposure(self) -> Exposure:
        """Return the exposure so far, each reading of the channel where it is largest."""
        running_m_s2 = max(one.running_m_s2 for one in self._readings)
        return Exposure.of([state.dose for state in self.safety_states()], running_m_s2)

    @property
    def exposure_gain(self) -> float:
        """Gain that the exposure cap allows, 0 to 1; 1 without a cap."""
        return min(one.exposure_gain for one in self._readings) if self.has_run else 1.0

    @property
    def strength_db(self) -> float | None:
        """Perceived strength so far in dB, against no damping and no protection.

        It is the ratio of the Wk-weighted r.m.s.; None without damping or before any vibration.
        """
        driven = max(one.squares for one in self._readings)
        undamped = max(one.undamped_squares for one in self._readings)
        return 0.5 * amplitude_to_db(driven / undamped) if driven and undamped else None

    def safety_states(self) -> tuple[SafetyState, ...]:
        """Return what must not be forgotten, for each channel."""
        return tuple(self._safety(channel) for channel in range(self.channels))

    def restore(self, states: Sequence[SafetyState]) -> None:
        """Continue with these states, one for each channel; a core reads them once, at first."""
        ambient_c = self.rig.thermal.ambient_c if self.rig.thermal else 0.0
        for controls, state in zip(self._controls, states, strict=False):
            safety, dose = controls.safety, state.dose
            safety.coil_c = ambient_c if state.coil_c is None else state.coil_c
            safety.magnet_c = ambient_c if state.magnet_c is None else state.magnet_c
            safety.time_s, safety.squares = dose.time_s, dose.squares
            safety.fourths, safety.above = dose.fourths, dose.high
            controls.restores = 1

    def keep(self) -> None:
        """Let a host that opens the core again continue from now on; repeat it while it runs."""
        if self._core_readings.frames != self._day_began_at:
            self._day_began_at = -1
        if self.has_run:
            self.restore(self.safety_states())

    def begin_day(self) -> None:
        """Begin a new day's dose with the next block, for all actuators of the core."""
        self._core_controls.day += 1
        self._day_began_at = self._core_readings.frames
        for controls in self._controls:  # those of a core that has not run yet
            safety = controls.safety
            safety.time_s = safety.squares = safety.fourths = safety.above = 0.0

    def _safety(self, channel: int) -> SafetyState:
        controls, thermal = self._controls[channel], self.rig.thermal
        if not self.has_run and not controls.restores:
            ambient_c = thermal.ambient_c if thermal else None
            return SafetyState(ambient_c, ambient_c)
        found = self._readings[channel] if self.has_run else controls.safety
        dose = DoseSums(found.time_s, found.squares, found.fourths, found.above)
        if self._day_began_at == self._core_readings.frames:
            dose = DoseSums()  # the core has not run since the day began
        if thermal is None:
            return SafetyState(dose=dose)
        return SafetyState(found.coil_c, found.magnet_c, dose)


def driven_rigs(
    designs: Sequence[DriveDesign | None], controls: Controls, readings: Readings, columns: int
) -> tuple[DrivenRig | None, ...]:
    """Return the rig of each design, None for None; each has this many of the core's actuators."""
    return tuple(
        DrivenRig(design, controls, readings, range(first, first + columns)) if design else None
        for first, design in zip(range(0, columns * len(designs), columns), designs, strict=True)
    )
