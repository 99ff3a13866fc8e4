"""Section "Residual vibration": vibration that remains after a burst, for several drives.

A drive is a source impedance with or without a filter that damps the actuator.
device/drive/damping.py defines the measured quantities.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

from device.drive.damping import (
    CURRENT_DRIVE_OHM,
    BurstResponse,
    Damping,
    Residual,
    burst_response,
    choose_damping,
    inverse_damping,
    undamped,
)
from device.rig import CONSUMER, PAPER, ActuatorParameters
from device.units import amplitude_to_db
from tools.bench.measures.large_bursts import large_burst_response, undamped_large
from tools.bench.report import Must, Row, Section
from tools.bench.workbench import Workbench

TITLE = "Residual vibration"
CHOSEN = "voltage drive, automatic"

DETUNINGS = (0.0, -0.05, 0.05, -0.1, 0.1, -0.2, 0.2)
NO_WORSE_DB = Must("<=", 0.0)
RIGS = (PAPER, CONSUMER)
CURVE = tuple(step / 100.0 for step in range(-20, 21))
EXACT_DB, DETUNED_DB, VOLTS_DB = Must("<=", -11.0), Must("<=", -7.0), Must("<=", 5.0)
LIMITED_DETUNING = 0.1
FIFTH = tuple(step / 100.0 for step in (-20, -15, -10, -5, 0, 5, 10, 15, 20))
STRONG = replace(PAPER.actuator, force_factor_n_per_a=16.0)
LEVELS = (0.05, 0.1, 0.25, 0.5, 1.0)  # intended excursion, as a share of Xmax
LOW_LEVEL = 0.1  # highest level to which limits apply


@dataclass(frozen=True)
class Drive:
    """One way of driving an actuator.

    asked: whether the results must meet limits.
    actuator: the driven actuator.
    """

    name: str
    damping: Damping
    asked: bool = False
    actuator: ActuatorParameters = PAPER.actuator


@cache
def drives() -> tuple[Drive, ...]:
    """Return all drives that are compared on the linear model; the first is the reference."""
    p, current = PAPER.actuator, CURRENT_DRIVE_OHM
    return (
        Drive("current drive, undamped", Damping(current)),
        Drive("voltage drive", Damping()),
        Drive("current drive, inverse to Q 0.7", inverse_damping(p, 0.7, current)),
        Drive("voltage drive, inverse to Q 0.7", inverse_damping(p, 0.7)),
        Drive(CHOSEN, choose_damping(p)[0].damping, asked=True),
        Drive("Bl 16, voltage drive", Damping(), actuator=STRONG),
        Drive("Bl 16, automatic", choose_damping(STRONG)[0].damping, asked=True, actuator=STRONG),
    )


@cache
def _reference(detuning: float) -> BurstResponse:
    return undamped(PAPER.actuator, detuning=detuning)


def _residual(drive: Drive, detuning: float) -> Residual:
    own = burst_response(drive.actuator, drive.damping, detuning=detuning)
    return own.against(_reference(detuning))


def residual_vibration(_bench: Workbench) -> Section:
    """Measure energy after a burst, settling time and peak voltage, for each drive."""
    rows: list[Row] = []
    for drive in drives():
        at = {detuning: _residual(drive, detuning) for detuning in DETUNINGS}
        rows += _rows(drive.name, at, limited=drive.asked)
    return Section(
        TITLE,
        "The *residual* is the energy of an actuator's acceleration after a burst of 50 ms, "
        "divided by the energy within the burst. The burst has the assumed resonance frequency f0, "
        "90 Hz for `paper`. The residual and the peak voltage (*peak volts*, for equal "
        "acceleration) are shown relative to current drive without damping. In the columns with %, "
        "the true f0 deviates from the assumed f0, because the stiffness is different. The column "
        "*still after* shows the time from the end of the burst until the acceleration stays under "
        "10 % of the burst's peak. Rows with Xmax (the excursion limit) use the non-linear model "
        "of the rig `paper`. In this model, stiffness, force factor and inductance change with "
        "excursion. Other rows use the linear model. The number before Xmax is the excursion of "
        "the linear model for the same drive; the note shows the excursion of the non-linear "
        "model. The *flat inverse* compensates the non-linearity of the assumed rig. The column "
        "*against none* shows the largest residual relative to voltage drive without damping. For "
        "this column, the true f0 is within ±20 % of the assumed f0, because the stiffness or the "
        "mass is different. The column *make-up gain* shows the gain with which a burst at f0 is "
        "as strong as without damping.",
        (*rows, *_rows_by_level(), *_rows_against_none()),
        series={
            drive.name: tuple(_residual(drive, share).residual_db for share in CURVE)
            for drive in drives()
        },
    )


def _rows_by_level() -> Iterator[Row]:
    chosen = choose_damping(PAPER.actuator)[0].damping
    ways = {
        "voltage drive": (Damping(), False),
        "automatic": (chosen, False),
        "automatic and flat inverse": (chosen, True),
    }
    for level in LEVELS:
        excursion_m = level * PAPER.actuator.x_max_m
        references = {d: undamped_large(PAPER, excursion_m, detuning=d) for d in DETUNINGS}
        for name, (damping, flat) in ways.items():
            bursts = {
                detuning: large_burst_response(
                    PAPER, damping, excursion_m, flat=flat, detuning=detuning
                )
                for detuning in DETUNINGS
            }
            at = {d: bursts[d].response.against(references[d].response) for d in DETUNINGS}
            limited = damping is chosen and level <= LOW_LEVEL
            reached = bursts[0.0].excursion_m / PAPER.actuator.x_max_m
            note = f"{reached:.3g} Xmax reached"
            yield from _rows(f"{level:g} Xmax, {name}", at, limited=limited, note=note)


def _rows_against_none() -> Iterator[Row]:
    for rig in RIGS:
        p, source = rig.actuator, rig.amplifier.source_impedance_ohm
        chosen = choose_damping(p, source_impedance_ohm=source)[0]
        none = Damping(source)
        worst_db = max(
            amplitude_to_db(
                math.sqrt(
                    burst_response(p, chosen.damping, detuning=detuning, mass=mass).residual
                    / burst_response(p, none, detuning=detuning, mass=mass).residual
                )
            )
            for share in FIFTH
            for detuning, mass in ((share, 1.0), (0.0, 1.0 / (1.0 + share) ** 2))
        )
        name = f"{rig.name}, automatic"
        yield Row(name, worst_db, "dB", "against none", NO_WORSE_DB)
        yield Row(name, amplitude_to_db(chosen.makeup), "dB", "make-up gain")


def _rows(name: str, at: dict[float, Residual], *, limited: bool, note: str = "") -> Iterator[Row]:
    for detuning, residual in at.items():
        asked = limited and abs(detuning) <= LIMITED_DETUNING
        must = (DETUNED_DB if detuning else EXACT_DB) if asked else None
        column = f"{100.0 * detuning:+.0f} %" if detuning else "exact"
        yield Row(name, residual.residual_db, "dB", column, must)
    yield Row(name, 1e3 * at[0.0].settling_s, "ms", "still after")
    must = VOLTS_DB if limited else None
    yield Row(name, at[0.0].peak_volts_db, "dB", "peak volts", must, note=note)
