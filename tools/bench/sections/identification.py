"""Section on identification: errors of f0 and Q of random rigs, and their intervals."""

from __future__ import annotations

from tools.bench.measures.random_rigs import (
    F0_ERROR,
    HELD,
    Q_ERROR,
    SHARES,
    SNR_DB,
    SWEEP_S,
    found_of,
    identified,
)
from tools.bench.report import Row, Section
from tools.bench.workbench import Workbench

ENOUGH = 20
"""Rigs from which the share of intervals has a limit: of fewer, one outside is too many."""


def identification(bench: Workbench) -> Section:
    """Errors and intervals of f0 and Q over random rigs, at two sweep levels."""
    count = bench.effort.random_rigs
    rows = []
    for share in SHARES:
        pairs = [identified(seed, share) for seed in range(count)]
        for seat, of in (("on the ground", pairs[::2]), ("on an occupied seat", pairs[1::2])):
            found, column = found_of(of), f"{share:g} Xmax, {seat}"
            rows += [
                Row("largest error of f0", found.f0_error_percent, "%", column, F0_ERROR),
                Row("largest error of Q", found.q_error_percent, "%", column, Q_ERROR),
            ]
            rows.append(Row("intervals that hold f0", found.f0_held_percent, "%", column))
            rows.append(Row("intervals that hold Q", found.q_held_percent, "%", column))
        whole, column = found_of(pairs), f"{share:g} Xmax, all"
        must = HELD if count >= ENOUGH else None
        rows.append(Row("intervals that hold f0", whole.f0_held_percent, "%", column, must))
        rows.append(Row("intervals that hold Q", whole.q_held_percent, "%", column, must))
    return Section(
        "Identification",
        f"f0 and Q of {count} random rigs, from one sweep each of {SWEEP_S:g} s from 15 to 400 Hz, "
        f"on the simulated non-linear rig with instrument noise at -{SNR_DB:g} dB. The columns say "
        "how much of Xmax the sweep moves. The truth is computed from the eigenvalues of the "
        "linear equations. The intervals are of 95 % and should hold it in 90 to 100 % of cases.",
        tuple(rows),
        footnote="A random rig has 0.1 to 0.5 kg, 35 to 120 Hz, Qms 3 to 15, 4 to 12 N/A and 3 to "
        "8 ohm; every other one is on a seat of 5 to 30 times its moving mass.",
    )
