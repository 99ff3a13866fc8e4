"""The limits of a rig, and the protection's numbers and tables for the core (protection.c).

The true actuator may differ from the rig file in stiffness, moving mass and Bl, and its frame may
move. A free frame of mass M changes the effective moving mass m to m M / (m + M). The effect of a
seat lies between the effects of a free frame and of solid ground. In a plot of stiffness over mass,
all possible actuators fill a rectangle. Models on two sides of this rectangle bound all responses:
the sides of the softest spring and of the lightest mass. Of all actuators with the same resonance
frequency, the one on these sides has the broadest resonance. Linear programming over all signals
shows that no actuator exceeds the largest motion of these models by more than the share `RESERVE`.
"""

import math
from dataclasses import dataclass

import numpy as np

from device.drive.protection.prediction import (
    LANES,
    DriveModel,
    amplifier_sections,
    prediction_records,
)
from device.errors import UsageError
from device.rig import ActuatorParameters, Rig
from device.rig.parameters import LargeSignalParameters, vary
from device.rig.thermal import COPPER_PER_K, Temperatures
from device.units import Records

APPROACH_S = 2.0  # time constant with which a coil approaches its temperature limit
LIGHTEST_FRAME_KG = 0.57  # a free board: it raises the resonance of a 0.25 kg mass by a fifth
RESERVE = 0.091  # reserved share of excursion and current limit for actuators between models
_SPACING = 0.24  # logarithm of the ratio of neighbouring resonance frequencies, times Q
_MODELS_MAX = 24
_STRONGER = 0.75
"""Share of the largest rise of Bl that all models have; it minimises the reserve. A large Bl gives
more excursion outside a resonance, a small Bl gives more at the resonance."""


@dataclass(frozen=True)
class Limits:
    """Limits of a rig; None means no limit.

    excursion_m: in either direction. current_a: peak. level: peak of the vibration, full scale 1.0.
    deviation: largest relative error of moving mass, Bl, and f0 (caused by the spring), 0 to 0.5.
    lightest_frame_kg: smallest mass of a free frame; inf for a fixed frame.
    stiffness_rise: see `LargeSignalParameters`.
    """

    excursion_m: float
    current_a: float | None = None
    coil_temperature_c: float | None = 120.0
    level: float = 1.0
    deviation: float = 0.1
    lightest_frame_kg: float = LIGHTEST_FRAME_KG
    stiffness_rise: float = LargeSignalParameters.stiffness_rise


def limits_of(rig: Rig) -> Limits:
    """Return the limits that follow from a rig.

    The level is full scale, or the level at which the amplifier clips if that is lower. The coil's
    temperature limit is 120 °C if the rig has [thermal]. Even if the rig describes a seat, the
    frame counts as free, with the smaller of `LIGHTEST_FRAME_KG` and the seat's mass.
    """
    full_scale_v = rig.dac.full_scale_v * rig.amplifier.gain
    current_a, large = rig.amplifier.current_limit_a, rig.large_signal
    return Limits(
        excursion_m=rig.actuator.x_max_m,
        current_a=None if math.isinf(current_a) else current_a,
        coil_temperature_c=Limits.coil_temperature_c if rig.thermal else None,
        level=min(1.0, rig.amplifier.output_limit_v / full_scale_v),
        lightest_frame_kg=min(LIGHTEST_FRAME_KG, rig.seat.mass_kg if rig.seat else math.inf),
        stiffness_rise=large.stiffness_rise if large else Limits.stiffness_rise,
    )


def bounding_models(
    p: ActuatorParameters, limits: Limits, source_impedance_ohm: float
) -> list[ActuatorParameters]:
    """Return the actuator as identified, then the models that bound all possible actuators."""
    d = limits.deviation
    lightest = 1.0 - d
    if math.isfinite(limits.lightest_frame_kg):
        on_frame = limits.lightest_frame_kg / p.moving_mass_kg
        lightest *= on_frame / (lightest + on_frame)
    softest, stiffest = (1.0 - d) ** 2, (1.0 + d) ** 2
    # A large excursion stiffens the spring: over a sine, the effective x^2 is 3/4 of the peak's.
    stiffest *= 1.0 + 0.75 * limits.stiffness_rise
    lowest, highest = math.sqrt(softest / (1.0 + d)), math.sqrt(stiffest / lightest)
    if highest <= lowest:
        return [p]
    span = math.log(highest / lowest)
    steps = min(max(1, math.ceil(span * p.q_total(source_impedance_ohm) / _SPACING)), _MODELS_MAX)
    models = [p]
    for step in range(steps + 1):
        ratio = lowest * math.exp(span * step / steps)
        mass = max(lightest, softest / ratio**2)
        models.append(vary(p, mass, mass * ratio**2, 1.0 + _STRONGER * d))
    return models


@dataclass(frozen=True)
class ProtectionStatus:
    """Counts since the start, and present values, of the protection.

    limited_blocks: blocks in which the gain was below 1. infeasible_blocks: blocks in which no gain
    could keep every limit; the gain became 0. replaced_samples: samples that counted as 0, because
    they were NaN or beyond ±1e6. gain, least_gain: smallest of all channels, now and since the
    start; 0 to 1. limited_by: cause of a gain below 1: "excursion, current or level",
    "temperature", "outside" (such as an exposure cap), or "". excursion_m: amplitude of a free
    oscillation with the present energy of the identified model. coil_c, resistance_ohm: temperature
    in °C and resistance of the warmest coil; None without a thermal model. latency_s: delay by the
    protection.
    """

    blocks: int
    limited_blocks: int
    infeasible_blocks: int
    replaced_samples: int
    gain: float
    least_gain: float
    limited_by: str
    excursion_m: float
    coil_c: float | None
    resistance_ohm: float | None
    latency_s: float


BLOCK_S = 0.002
BLOCKS_AHEAD = 2  # a block leaves when the next block is known, two block lengths after its start
RECOVERY_S = 0.02  # time in which the gain recovers from 0 to the allowed gain
HOLD_S = 0.06  # hold time of the demand: more than a period of 20 Hz, for a steady gain
# Factor on the demand (ratio of predicted motion to its limit) after each limited block. Otherwise
# the oscillation after a limited block would reach the limit again in every period.
CAUTION = 1.03
RELEASE_S = 0.5  # time constant with which the demand decays after the hold time
WANTED_RISE_S, WANTED_FALL_S = 0.03, 2.0  # time constants of the wanted power's rise and decay
_FINE_HZ = 32_000  # from this sample rate on, a block consists of whole groups of `LANES` frames


def latency_frames(samplerate: int) -> int:
    """Return the delay of the protection in frames: two blocks."""
    return BLOCKS_AHEAD * _block_frames(samplerate)


def protection_records(rig: Rig, samplerate: int, limits: Limits | None = None) -> Records:
    """Return numbers and tables of the protection, named as in `ProtectionDesign` of the core.

    While no limit is near, every sample is output unchanged after `latency_frames`.
    samplerate: Hz, 1000 or more. limits: None for the limits of the rig.
    UsageError: the coil's temperature is limited, but the rig has no [thermal].
    """
    limits = limits or limits_of(rig)
    thermal, hottest_c = rig.thermal, limits.coil_temperature_c
    if hottest_c is not None and thermal is None:
        raise UsageError(
            f"coil_temperature_c={hottest_c!r} cannot be kept: the rig {rig.name!r} describes no "
            "[thermal]; add it, or set no limit"
        )
    period_s = _block_frames(samplerate) / samplerate
    prediction, current_a = _predict(rig, samplerate, limits)
    ambient_c = thermal.ambient_c if thermal else 20.0
    return {
        **prediction,
        "hold_blocks": math.ceil(HOLD_S / period_s),
        "level": limits.level,
        "current_a": current_a or 0.0,
        "recovery": period_s / RECOVERY_S,
        "release": math.exp(-period_s / RELEASE_S),
        "notice": 1.0 - math.exp(-period_s / WANTED_RISE_S),
        "forget": math.exp(-period_s / WANTED_FALL_S),
        "caution": CAUTION,
        "hottest_k": 0.0 if hottest_c is None else max(1e-9, hottest_c - ambient_c),
        "ambient_c": ambient_c,
        "resistance_ohm": rig.actuator.resistance_ohm,
        "resistance_per_k": COPPER_PER_K / (1.0 + COPPER_PER_K * (ambient_c - 20.0)),
        "coil_k_per_w": thermal.coil_k_per_w if thermal else 1.0,
        "coil_j_per_k": thermal.coil_j_per_k if thermal else 1.0,
        "approach_s": APPROACH_S,
        "thermal": np.array(Temperatures(thermal).step(period_s) if thermal else []),
    }


def _block_frames(samplerate: int) -> int:
    """Return a block's length in frames: from 32 kHz on, a multiple of `LANES`."""
    multiple = 1 if samplerate < _FINE_HZ else LANES
    return multiple * round(BLOCK_S * samplerate / multiple)


def _predict(rig: Rig, samplerate: int, limits: Limits) -> tuple[Records, float | None]:
    """Return the prediction's tables, and the current limit in A, None if absent or unreachable."""
    volts = rig.dac.full_scale_v * rig.amplifier.gain
    source = rig.amplifier.source_impedance_ohm
    models = bounding_models(rig.actuator, limits, source)
    sections = amplifier_sections(rig.amplifier, models, samplerate)
    drives = [DriveModel(model, samplerate, source, sections, volts) for model in models]
    if (current_a := limits.current_a) is not None:
        most_a = max(drive.reach("current_a") for drive in drives) * limits.level * volts
        current_a *= 1.0 - RESERVE
        current_a = current_a if most_a > current_a else None
    limited = 0 if current_a is None else len(drives)
    excursion_m = (1.0 - RESERVE) * limits.excursion_m
    return prediction_records(drives, _block_frames(samplerate), excursion_m, limited), current_a
