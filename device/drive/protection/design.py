"""Protection of a rig as numbers and tables: what the core's protection (protection.c) works by."""

from __future__ import annotations

import math

import numpy as np

from device.drive.protection.limits import APPROACH_S, RESERVE, Limits, bounding_models, limits_of
from device.drive.protection.prediction import (
    LANES,
    DriveModel,
    amplifier_sections,
    prediction_records,
)
from device.errors import UsageError
from device.rig import Rig
from device.rig.thermal import COPPER_PER_K, Temperatures
from device.units import Records

BLOCK_S = 0.002
BLOCKS_AHEAD = 2  # a block leaves when the next block is known: two block lengths after its start

RECOVERY_S = 0.02  # time in which the gain recovers from 0 to what the demand allows
HOLD_S = 0.06  # demand is held so long: more than a period of 20 Hz, for a steady gain
CAUTION = 1.03
"""Factor on the demand after each block in which the bound limited the gain. That limit makes the
actuator swing, and the bound would act again in every period."""
RELEASE_S = 0.5  # time constant of the demand's decay after that
WANTED_RISE_S, WANTED_FALL_S = 0.03, 2.0  # time constants of the wanted power's rise and decay

_FINE_HZ = 32_000  # from here on a block has whole groups


def latency_frames(samplerate: int) -> int:
    """Return the delay of the protection in frames: two blocks."""
    return BLOCKS_AHEAD * _block_frames(samplerate)


def protection_records(rig: Rig, samplerate: int, limits: Limits | None = None) -> Records:
    """Return the design of the protection of a rig, by name; see `ProtectionDesign` of the core.

    While no limit is near, every sample leaves unchanged, `latency_frames` later.

    samplerate: Hz, 1000 or more. limits: None for the limits of the rig.
    UsageError: the coil's temperature is limited and the rig does not describe how it warms up.
    """
    limits = limits or limits_of(rig)
    thermal, hottest_c = rig.thermal, limits.coil_temperature_c
    if hottest_c is not None and thermal is None:
        raise UsageError(
            f"coil_temperature_c={hottest_c!r} cannot be kept: the rig {rig.name!r} describes no "
            "[thermal]; add it, or set no limit"
        )
    frames = _block_frames(samplerate)
    period_s = frames / samplerate
    prediction, current_a = _predict(rig, samplerate, limits)
    ambient_c = thermal.ambient_c if thermal else 20.0
    heating = Temperatures(thermal).step(period_s) if thermal else []
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
        "thermal": np.array(heating),
    }


def _block_frames(samplerate: int) -> int:
    """Return the length of a block; a long one has divisors, for few points of a free swing."""
    multiple = 1 if samplerate < _FINE_HZ else LANES
    return multiple * round(BLOCK_S * samplerate / multiple)


def _predict(rig: Rig, samplerate: int, limits: Limits) -> tuple[Records, float | None]:
    """Return the prediction, and the limit of the current in A; None if no drive can reach it."""
    volts = rig.dac.full_scale_v * rig.amplifier.gain
    source = rig.amplifier.source_impedance_ohm
    models = bounding_models(rig.actuator, limits, source)
    sections = amplifier_sections(rig.amplifier, models, samplerate)
    drives = [DriveModel(model, samplerate, source, sections, volts) for model in models]
    current_a = limits.current_a
    if current_a is not None:
        most_a = max(drive.reach("current_a") for drive in drives) * limits.level * volts
        current_a *= 1.0 - RESERVE
        current_a = current_a if most_a > current_a else None
    limited = 0 if current_a is None else len(drives)
    excursion_m = (1.0 - RESERVE) * limits.excursion_m
    return prediction_records(drives, _block_frames(samplerate), excursion_m, limited), current_a
