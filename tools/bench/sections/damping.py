"""Section on damping: what a burst leaves by each drive and level, and what it costs in volts.

device/drive/damping defines residual, settling, peak volts and detuning.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

from device.drive.damping import Damping, choose_damping
from device.drive.damping.design import inverse_damping, no_damping, shaper_damping
from device.drive.damping.residual import (
    CURRENT_DRIVE_OHM,
    BurstResponse,
    Residual,
    burst_response,
    undamped,
)
from device.rig import PAPER, ActuatorParameters
from tools.bench.measures.large_bursts import LargeBurst, large_burst_response, undamped_large
from tools.bench.report import Must, Row, Section
from tools.bench.workbench import Workbench

TITLE = "Residual vibration"
LEVELS_TITLE = "Residual vibration by level"
CHOSEN = "voltage drive, automatic"
FLAT = "automatic and flat inverse"

DETUNINGS = (0.0, -0.05, 0.05, -0.1, 0.1, -0.2, 0.2)
CURVE = tuple(step / 100.0 for step in range(-20, 21))
EXACT_DB, DETUNED_DB, VOLTS_DB = Must("<=", -11.0), Must("<=", -7.0), Must("<=", 5.0)
LIMITED_DETUNING = 0.1
LATENCY_S = 0.005
STRONG = replace(PAPER.actuator, force_factor_n_per_a=16.0)

LEVELS = (0.05, 0.1, 0.25, 0.5, 1.0)
"""Intended excursion, in Xmax."""
LOW_LEVEL = 0.1
"""Highest level with limits."""


@dataclass(frozen=True)
class Drive:
    """One way of driving: name, damping, whether limits apply, actuator, flat inverse or not."""

    name: str
    damping: Damping
    asked: bool = False
    actuator: ActuatorParameters = PAPER.actuator
    flat: bool = False


@cache
def drives() -> tuple[Drive, ...]:
    """Return all drives that are compared on the linear model, the reference first."""
    p, current = PAPER.actuator, CURRENT_DRIVE_OHM
    shaped = choose_damping(p, latency_s=LATENCY_S).damping
    return (
        Drive("current drive, undamped", no_damping(current)),
        Drive("voltage drive", no_damping()),
        Drive("current drive, inverse to Q 0.7", inverse_damping(p, 0.7, current)),
        Drive("current drive, ZV shaper", shaper_damping(p, "zv", current)),
        Drive("voltage drive, inverse to Q 0.7", inverse_damping(p, 0.7)),
        Drive(CHOSEN, choose_damping(p).damping, asked=True),
        Drive(f"{CHOSEN}, {1e3 * LATENCY_S:g} ms of latency", shaped, asked=True),
        Drive("Bl 16, voltage drive", no_damping(), actuator=STRONG),
        Drive("Bl 16, automatic", choose_damping(STRONG).damping, asked=True, actuator=STRONG),
    )


@cache
def large_drives() -> tuple[Drive, ...]:
    """Return the drives that are compared on the non-linear model, the reference first."""
    chosen = choose_damping(PAPER.actuator).damping
    return (
        Drive("current drive, undamped", no_damping(CURRENT_DRIVE_OHM)),
        Drive("voltage drive", no_damping()),
        Drive("automatic", chosen, asked=True),
        Drive(FLAT, chosen, asked=True, flat=True),
    )


@cache
def _reference(detuning: float) -> BurstResponse:
    return undamped(PAPER.actuator, detuning=detuning)


def _residual(drive: Drive, detuning: float) -> Residual:
    """Return what a burst leaves, against current drive of the `paper` rig."""
    own = burst_response(drive.actuator, drive.damping, detuning=detuning)
    return own.against(_reference(detuning))


def residual_energy(_bench: Workbench) -> Section:
    """Energy after a burst, settling and peak volts of each drive, by detuning."""
    rows = []
    for drive in drives():
        at = {detuning: _residual(drive, detuning) for detuning in DETUNINGS}
        rows += _detuning_rows(drive.name, at, limited=drive.asked)
        for detuning in (0.0, -LIMITED_DETUNING, LIMITED_DETUNING):
            column = f"still after, {_column(detuning)}"
            rows.append(Row(drive.name, 1e3 * at[detuning].settling_s, "ms", column))
        must = VOLTS_DB if drive.asked else None
        volts_db, note = at[0.0].peak_volts_db, _note(drive.damping)
        rows.append(Row(drive.name, volts_db, "dB", "peak volts", must, note=note))
    return Section(
        TITLE,
        "Energy of the seat's acceleration after a burst of 50 ms at 90 Hz, against undamped "
        "current drive of the same rig at the same vibration during the burst; and the peak volts "
        "against the same. Columns: the true f0 against the assumed one (only the stiffness "
        "differs). Still after: time from the end of the burst until the acceleration stays under "
        "10 % of its peak. The model is linear, so this holds up to about 0.1 Xmax.",
        tuple(rows),
        series={
            drive.name: tuple(_residual(drive, share).residual_db for share in CURVE)
            for drive in drives()
        },
    )


@cache
def _burst(drive: Drive, level: float, detuning: float) -> LargeBurst:
    excursion_m = level * PAPER.actuator.x_max_m
    return large_burst_response(
        PAPER, drive.damping, excursion_m, flat=drive.flat, detuning=detuning
    )


@cache
def _large_reference(level: float, detuning: float) -> LargeBurst:
    return undamped_large(PAPER, level * PAPER.actuator.x_max_m, detuning=detuning)


def residual_energy_by_level(_bench: Workbench) -> Section:
    """Energy after a burst, settling and peak volts by level and detuning."""
    rows = []
    low = undamped(PAPER.actuator)
    for level in LEVELS:
        for drive in large_drives():
            name = f"{level:g} Xmax, {drive.name}"
            limited = drive.asked and level <= LOW_LEVEL
            at = {
                detuning: _burst(drive, level, detuning).response.against(
                    _large_reference(level, detuning).response
                )
                for detuning in DETUNINGS
            }
            rows += _detuning_rows(name, at, limited=limited)
            exact = _burst(drive, level, 0.0)
            low_db = exact.response.against(low).residual_db
            reached = exact.excursion_m / PAPER.actuator.x_max_m
            must = VOLTS_DB if limited else None
            rows += [
                Row(name, 1e3 * exact.response.settling_s, "ms", "still after, exact"),
                Row(name, at[0.0].peak_volts_db, "dB", "peak volts", must),
                Row(name, low_db, "dB", "exact, against low level"),
                Row(name, reached, "Xmax", "reached"),
            ]
    return Section(
        LEVELS_TITLE,
        "The same bursts on the non-linear `paper` rig, which stiffens, loses force and changes "
        "its inductance as it swings. The level is the largest excursion of the linear model. "
        "Residual and peak volts are against undamped current drive of the same rig at the same "
        "level and detuning. That drive rings less at high levels, as its resonance moves away, "
        "so there is a column against current drive at a low level. The flat inverse is that of "
        "the assumed rig. Reached: the largest excursion, f0 exact.",
        tuple(rows),
    )


def _detuning_rows(name: str, at: dict[float, Residual], *, limited: bool) -> list[Row]:
    rows = []
    for detuning, residual in at.items():
        must = None
        if limited and abs(detuning) <= LIMITED_DETUNING:
            must = DETUNED_DB if detuning else EXACT_DB
        rows.append(Row(name, residual.residual_db, "dB", _column(detuning), must))
    return rows


def _column(detuning: float) -> str:
    return f"{100.0 * detuning:+.0f} %" if detuning else "exact"


def _note(damping: Damping) -> str:
    if damping.impulses:
        return f"latency {1e3 * damping.latency_s:.1f} ms"
    if damping.ringing is None or damping.wanted is None:
        return ""
    at_hz = damping.ringing.frequency_hz
    return f"Q {damping.ringing.q:.2f} to {damping.wanted.q:.2f} at {at_hz:.1f} Hz"
