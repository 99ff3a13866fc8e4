"""Bench on identification: how far f0 and Q of random rigs are off, and whether it says so."""

from __future__ import annotations

import time

from tools.bench.machine import cpu_model
from tools.bench.measures.random_rigs import (
    F0_ERROR,
    HELD,
    Q_ERROR,
    RIGS,
    SHARES,
    SNR_DB,
    SWEEP_S,
    found_of,
    identified,
)
from tools.bench.report import Row, Section
from tools.bench.soak_record import SoakRecord, now
from tools.bench.workbench import Workbench


def identification(bench: Workbench) -> Section:
    """Errors and intervals of f0 and Q over random rigs, at two levels of the sweep."""
    count = bench.effort.random_rigs
    rows = []
    for share in SHARES:
        pairs = [identified(seed, share) for seed in range(count)]
        for seat, of in (("on the ground", pairs[::2]), ("on a seat that is sat on", pairs[1::2])):
            found, column = found_of(of), f"{share:g} Xmax, {seat}"
            rows += [
                Row("largest error of f0", found.f0_error_percent, "%", column, F0_ERROR),
                Row("largest error of Q", found.q_error_percent, "%", column, Q_ERROR),
            ]
            rows.append(Row("intervals that hold f0", found.f0_held_percent, "%", column))
            rows.append(Row("intervals that hold Q", found.q_held_percent, "%", column))
        whole, column = found_of(pairs), f"{share:g} Xmax, all"
        # Of a few intervals of 95 % one that fails is already too many.
        must = HELD if count >= _ENOUGH else None
        rows.append(Row("intervals that hold f0", whole.f0_held_percent, "%", column, must))
        rows.append(Row("intervals that hold Q", whole.q_held_percent, "%", column, must))
    return Section(
        "Identification",
        f"f0 and Q of {count} random rigs, from one sweep each, {SWEEP_S:g} s from 15 to 400 Hz, "
        f"on the non-linear twin, read through its instruments with noise {SNR_DB:g} dB down. The "
        "columns say how much of Xmax the sweep moves. The truth is that of the linear equations "
        "by their eigenvalues; the intervals are of 95 % and should hold it in 90 to 100 % of all "
        "cases.",
        tuple(rows),
        footnote="A random rig: 0.1 to 0.5 kg, 35 to 120 Hz, Qms 3 to 15, 4 to 12 N/A, 3 to 8 "
        "ohm; every other one is on a seat of 5 to 30 times its moving mass.",
    )


_ENOUGH = 20


def soak_identification(share: float, rigs: int = RIGS) -> SoakRecord:
    """What is found of many random rigs by sweeps of that share of Xmax."""
    start_s = time.process_time()
    pairs = [identified(seed, share) for seed in range(rigs)]
    found = found_of(pairs)
    return SoakRecord(
        what=f"sweeps at {share:g} Xmax",
        date=now(),
        cpu=cpu_model(),
        stream_s=rigs * SWEEP_S,
        took_s=time.process_time() - start_s,
        passed=found.passed,
        rigs=rigs,
        f0_error_percent=found.f0_error_percent,
        q_error_percent=found.q_error_percent,
        f0_held_percent=found.f0_held_percent,
        q_held_percent=found.q_held_percent,
    )
