"""Bench on damping: what a burst leaves behind by each way of driving, and what it costs in volts.

Residual, settling, peak volts and detuning are defined in device/drive/damping/residual.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

from device.drive.damping import (
    BurstResponse,
    Damping,
    Residual,
    burst_response,
    choose_damping,
    inverse_damping,
    no_damping,
    shaper_damping,
    undamped,
)
from device.drive.damping.residual import CURRENT_DRIVE_OHM
from device.rig import PAPER, ActuatorParameters
from tools.bench.report import Must, Row, Section
from tools.bench.workbench import Workbench

TITLE = "Residual vibration"
SETTLING_TITLE = "Time until the seat is still"
CHOSEN = "voltage drive, automatic"

DETUNINGS = (0.0, -0.05, 0.05, -0.1, 0.1, -0.2, 0.2)
CURVE = tuple(step / 100.0 for step in range(-20, 21))
EXACT_DB, DETUNED_DB, VOLTS_DB = Must("<=", -11.0), Must("<=", -7.0), Must("<=", 5.0)
LATENCY_S = 0.005

STRONG = replace(PAPER.actuator, force_factor_n_per_a=16.0)


@dataclass(frozen=True)
class Way:
    """One way of driving: what it is called, the actuator, the damping, whether limits apply."""

    name: str
    actuator: ActuatorParameters
    damping: Damping
    asked: bool = False

    def against_undamped(self, detuning: float) -> Residual:
        """Return what a burst leaves, against current drive of the `paper` rig."""
        own = burst_response(self.actuator, self.damping, detuning=detuning)
        return own.against(_reference(detuning))


@cache
def _reference(detuning: float) -> BurstResponse:
    return undamped(PAPER.actuator, detuning=detuning)


@cache
def ways() -> tuple[Way, ...]:
    """Return all ways that are compared, the reference first."""
    p = PAPER.actuator
    current = CURRENT_DRIVE_OHM
    chosen = choose_damping(p).damping
    shaped = choose_damping(p, latency_s=LATENCY_S).damping
    return (
        Way("current drive, undamped", p, no_damping(current)),
        Way("voltage drive", p, no_damping()),
        Way("current drive, inverse to Q 0.7", p, inverse_damping(p, 0.7, current)),
        Way("current drive, ZV shaper", p, shaper_damping(p, "zv", current)),
        Way("voltage drive, inverse to Q 0.7", p, inverse_damping(p, 0.7)),
        Way(CHOSEN, p, chosen, asked=True),
        Way(f"{CHOSEN}, {1e3 * LATENCY_S:g} ms of latency", p, shaped, asked=True),
        Way("Bl 16, voltage drive", STRONG, no_damping()),
        Way("Bl 16, automatic", STRONG, choose_damping(STRONG).damping, asked=True),
    )


def residual_energy(_bench: Workbench) -> Section:
    """Energy after a burst, and peak volts, of each way at every detuning."""
    rows = []
    for way in ways():
        at = {detuning: way.against_undamped(detuning) for detuning in DETUNINGS}
        for detuning, residual in at.items():
            must = None
            if way.asked and abs(detuning) <= 0.1:
                must = DETUNED_DB if detuning else EXACT_DB
            rows.append(Row(way.name, residual.residual_db, "dB", detuning_column(detuning), must))
        volts_db = at[0.0].peak_volts_db
        rows.append(
            Row(way.name, volts_db, "dB", "peak volts", VOLTS_DB if way.asked else None,
                note=_note(way.damping))
        )  # fmt: skip
    series = {
        way.name: tuple(way.against_undamped(share).residual_db for share in CURVE)
        for way in ways()
    }
    return Section(
        TITLE,
        "Energy of the seat's acceleration after a burst of 50 ms at 90 Hz, against undamped "
        "current drive of the same rig at the same vibration during the burst; and the peak volts "
        "that takes, against the same. Columns: how far the true f0 lies from the one believed "
        "(another stiffness; mass and friction as believed). Linear rung, so at a level of 0.1 "
        "Xmax or less. A way with a latency has its burst's end later by that.",
        tuple(rows),
        series=series,
    )


def settling_time(_bench: Workbench) -> Section:
    """Time until the acceleration stays under a tenth, of each way at every detuning."""
    rows = [
        Row(
            way.name,
            1e3 * way.against_undamped(detuning).settling_s,
            "ms",
            detuning_column(detuning),
        )
        for way in ways()
        for detuning in DETUNINGS
    ]
    return Section(
        SETTLING_TITLE,
        "Time after the end of the same bursts until the acceleration stays under 10 % of the "
        "burst's peak.",
        tuple(rows),
    )


def detuning_column(detuning: float) -> str:
    """Return the heading of a column for one detuning."""
    return f"{100.0 * detuning:+.0f} %" if detuning else "exact"


def _note(damping: Damping) -> str:
    if damping.impulses:
        return f"latency {1e3 * damping.latency_s:.1f} ms"
    if damping.ringing is None or damping.wanted is None:
        return ""
    at_hz = damping.ringing.frequency_hz
    return f"Q {damping.ringing.q:.2f} to {damping.wanted.q:.2f} at {at_hz:.1f} Hz"
