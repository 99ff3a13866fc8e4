"""Damping, protection and exposure meter of one rig, as numbers and tables for the core."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from device.drive.damping import Damping, choose_damping
from device.drive.exposure import DoseSums, exposure_records, worst_second
from device.drive.protection.design import Limits, latency_frames, protection_records
from device.drive.safety import SafetyBounds
from device.rig import ActuatorParameters, Rig, rig_by_name
from device.rig.thermal import Temperatures
from device.units import Records, amplitude_to_db


@dataclass(frozen=True)
class DriveDesign:
    """Damping, protection and exposure meter of one rig. Immutable; any thread may use it.

    Protection is always on, since a damped signal may exceed full scale and must not be clipped.
    samplerate: Hz, 6000 or more. damping: None without damping. exposure_cap: one of `CAPS`; above
    half of the cap's dose the gain falls slowly. limits: None for the limits of the rig. records:
    numbers and tables, named as in `DriveDesign` of the core. worst_second: upper bound on the dose
    of one second. UsageError: samplerate is too low, or the rig lacks [thermal] for its limits.
    """

    rig: Rig
    samplerate: int
    damping: Damping | None = None
    exposure_cap: str = "off"
    limits: Limits | None = None
    records: Records = field(init=False, compare=False, repr=False)
    worst_second: DoseSums = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        damping = self.damping
        sections = damping.sections(self.samplerate) if damping else np.empty((0, 6))
        exposure = exposure_records(self.rig, self.samplerate, self.exposure_cap)
        protection = protection_records(self.rig, self.samplerate, self.limits)
        records = {
            "damping_gain": damping.gain if damping else 0.0,
            "damping.count": len(sections),
            "damping.sections": sections,
            **{f"protection.{name}": value for name, value in protection.items()},
            **{f"exposure.{name}": value for name, value in exposure.items()},
        }
        object.__setattr__(self, "records", records)
        object.__setattr__(self, "worst_second", worst_second(self.rig, self.samplerate))

    @property
    def latency_frames(self) -> int:
        """Delay of the vibration by the protection, in frames."""
        return latency_frames(self.samplerate)

    @property
    def makeup_db(self) -> float:
        """Gain in dB that restores the level at the resonance after damping; 0 without damping."""
        return amplitude_to_db(self.damping.gain) if self.damping else 0.0

    def resistance_ohm(self, coil_c: float) -> float:
        """Return the coil's resistance at coil_c, °C; constant if the rig has no [thermal]."""
        thermal, ohm = self.rig.thermal, self.rig.actuator.resistance_ohm
        if thermal is None:
            return ohm
        warm = Temperatures(thermal)
        warm.coil_k = coil_c - thermal.ambient_c
        return warm.resistance_ohm(ohm)

    def bounds(self) -> SafetyBounds:
        """Return upper bounds on the actuator's temperature and the exposure dose."""
        return SafetyBounds(self.rig, self.worst_second)


def drive_design(
    rig: str,
    samplerate: int,
    *,
    damping: str = "off",
    protection: str = "off",
    exposure_cap: str = "off",
) -> DriveDesign | None:
    """Return the design; None if damping, protection and exposure_cap are all "off".

    rig: a name or a file. UsageError: the rig is missing or invalid, or the rate is too low.
    """
    plan = DrivePlan.of(rig, samplerate, damping, protection, exposure_cap)
    return plan and design_of(plan)


class DrivePlan(NamedTuple):
    """The arguments of a design; see `DriveDesign`."""

    rig: Rig
    samplerate: int
    is_damped: bool
    exposure_cap: str

    @classmethod
    def of(
        cls, rig: str, samplerate: int, damping: str, protection: str, exposure_cap: str
    ) -> "DrivePlan | None":
        """Return the plan; None if the last three are "off". UsageError: see `rig_by_name`."""
        if {damping, protection, exposure_cap} == {"off"}:
            return None
        return cls(rig_by_name(rig), samplerate, damping != "off", exposure_cap)


@lru_cache(maxsize=16)
def design_of(plan: DrivePlan) -> DriveDesign:
    """Return the design; slow for a new plan. UsageError: the sample rate is too low."""
    source = plan.rig.amplifier.source_impedance_ohm
    damping = damping_for(plan.rig.actuator, source) if plan.is_damped else None
    return DriveDesign(plan.rig, plan.samplerate, damping, plan.exposure_cap)


def designs_of(plans: Sequence[DrivePlan]) -> list[DriveDesign]:
    """Return the design of each plan. UsageError: see `design_of`."""
    return list(map(design_of, plans))


@lru_cache(maxsize=8)
def damping_for(actuator: ActuatorParameters, source_impedance_ohm: float) -> Damping:
    """Return the damping filter with its gain; the first call for each actuator is slow."""
    chosen = choose_damping(actuator, source_impedance_ohm=source_impedance_ohm)[0]
    return replace(chosen.damping, gain=chosen.makeup)
