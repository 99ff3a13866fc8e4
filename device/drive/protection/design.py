"""The parameters of a rig's protection as numbers and tables for the core (protection.c)."""

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
    current_a = limits.current_a
    if current_a is not None:
        most_a = max(drive.reach("current_a") for drive in drives) * limits.level * volts
        current_a *= 1.0 - RESERVE
        current_a = current_a if most_a > current_a else None
    limited = 0 if current_a is None else len(drives)
    excursion_m = (1.0 - RESERVE) * limits.excursion_m
    return prediction_records(drives, _block_frames(samplerate), excursion_m, limited), current_a
