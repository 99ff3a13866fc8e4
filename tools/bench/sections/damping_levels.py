"""Bench on damping at higher levels: the same bursts on the rig's non-linear rung.

The definitions stand in device/drive/damping/residual.py and large_bursts.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

from device.drive.damping import (
    Damping,
    LargeBurst,
    choose_damping,
    large_burst_response,
    no_damping,
    undamped,
    undamped_large,
)
from device.drive.damping.large_bursts import CURRENT_DRIVE_OHM
from device.rig import PAPER
from tools.bench.report import Row, Section
from tools.bench.sections.damping import (
    DETUNED_DB,
    DETUNINGS,
    EXACT_DB,
    VOLTS_DB,
    detuning_column,
)
from tools.bench.workbench import Workbench

TITLE = "Residual vibration on the non-linear rung"
SETTLING_TITLE = "Time until the seat is still, on the non-linear rung"
LEVELS = (0.05, 0.1, 0.25, 0.5, 1.0)
"""Intended excursion, in Xmax."""
LOW_LEVEL = 0.1
"""Up to which the limits are asked."""
FLAT = "automatic and flat inverse"


@dataclass(frozen=True)
class Way:
    """One way of driving: its name, the damping, whether the flat inverse follows, and limits."""

    name: str
    damping: Damping
    flat: bool = False
    asked: bool = False


@cache
def ways() -> tuple[Way, ...]:
    """Return the ways that are compared, the reference first."""
    chosen = choose_damping(PAPER.actuator).damping
    return (
        Way("current drive, undamped", no_damping(CURRENT_DRIVE_OHM)),
        Way("voltage drive", no_damping()),
        Way("automatic", chosen, asked=True),
        Way(FLAT, chosen, flat=True, asked=True),
    )


@cache
def _burst(way: Way, level: float, detuning: float) -> LargeBurst:
    excursion_m = level * PAPER.actuator.x_max_m
    return large_burst_response(PAPER, way.damping, excursion_m, flat=way.flat, detuning=detuning)


@cache
def _reference(level: float, detuning: float) -> LargeBurst:
    return undamped_large(PAPER, level * PAPER.actuator.x_max_m, detuning=detuning)


def _cases() -> Iterator[tuple[Way, float, str]]:
    """Return each way at each level, and the name of its line, level after level."""
    for level in LEVELS:
        for way in ways():
            yield way, level, f"{level:g} Xmax, {way.name}"


def residual_energy_by_level(_bench: Workbench) -> Section:
    """Energy after a burst, and what it takes, at each level and detuning."""
    rows = []
    low = undamped(PAPER.actuator)
    for way, level, name in _cases():
        limited = way.asked and level <= LOW_LEVEL
        for detuning in DETUNINGS:
            burst = _burst(way, level, detuning)
            shown = burst.response.against(_reference(level, detuning).response)
            must = None
            if limited and abs(detuning) <= 0.1:
                must = DETUNED_DB if detuning else EXACT_DB
            column = detuning_column(detuning)
            rows.append(Row(name, shown.residual_db, "dB", column, must))
        burst = _burst(way, level, 0.0)
        shown = burst.response.against(_reference(level, 0.0).response)
        reached = burst.excursion_m / PAPER.actuator.x_max_m
        rows += [
            Row(name, shown.peak_volts_db, "dB", "peak volts", VOLTS_DB if limited else None),
            Row(name, burst.response.against(low).residual_db, "dB", "exact, against low level"),
            Row(name, reached, "Xmax", "reached"),
        ]
    return Section(
        TITLE,
        "The same bursts, on the `paper` rig as it is: it stiffens, loses force and changes its "
        "inductance as it swings. The level is the largest excursion that the linear rung would "
        "reach with the drive. Residual and peak volts are against undamped current drive of the "
        "same rig at the same level, detuned alike. That one rings less where it swings far, as "
        "its resonance leaves the burst's frequency, so beside it stands the residual at the "
        "exact f0 against current drive at a low level. The flat inverse is that of the rig as "
        "believed. Reached: the largest excursion, f0 exact.",
        tuple(rows),
    )


def settling_time_by_level(_bench: Workbench) -> Section:
    """Time until the acceleration stays under a tenth, at each level and detuning."""
    rows = [
        Row(name, 1e3 * _burst(way, level, detuning).response.settling_s, "ms",
            detuning_column(detuning))
        for way, level, name in _cases()
        for detuning in DETUNINGS
    ]  # fmt: skip
    return Section(
        SETTLING_TITLE,
        "Time after the end of the same bursts until the acceleration stays under 10 % of the "
        "burst's peak.",
        tuple(rows),
    )
