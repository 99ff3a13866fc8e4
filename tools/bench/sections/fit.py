"""Section "Fit": `cushion fit` with simulated people, whose sensitivity is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.fit import PROTOCOL
from audioflinger_hook.fit.curve import HZ, resonance_db
from audioflinger_hook.fit.session import FitSession, SimulatedSitter
from audioflinger_hook.trials.record import Rows, run
from tools.bench.report import Must, Row, Section
from tools.bench.workbench import Workbench

TITLE = "Fit"
LARGEST_DB = 15.0  # of the smooth process
NODES_A_SPAN, SPAN = 41, (20.0, 250.0)
MEDIAN_DB, MOST_DB = Must("<=", 1.5), Must("<=", 2.5)
REFUSED, FALSELY = Must(">=", 95.0), Must("<=", 2.0)
RANDOM = 1.0  # lapse of a person who guesses


def sitter(seed: int, lapse: float | None = None) -> SimulatedSitter:
    """Return a person with a smooth random curve, a resonance of the rig, and lapses.

    lapse: share of guessed answers, by default from 0 to 5 %.
    """
    random = np.random.default_rng(seed)
    hz = np.union1d(np.geomspace(*SPAN, NODES_A_SPAN), HZ)
    octaves = np.log2(hz)
    apart = (octaves[:, None] - octaves) / random.uniform(0.5, 1.5)
    root = np.linalg.cholesky(np.exp(-0.5 * apart**2) + 1e-6 * np.eye(hz.size))
    smooth = root @ random.normal(size=hz.size)
    smooth *= random.uniform(0.3, 1.0) * LARGEST_DB / np.abs(smooth).max()
    resonance_hz, q = np.exp(random.uniform(*np.log([28.0, 180.0]))), random.uniform(2.0, 8.0)
    peak = 20.0 * np.log10(q) * np.exp(-0.5 * (np.log2(hz / resonance_hz) * q) ** 2)
    felt = smooth + (resonance_db(hz, resonance_hz, q) if seed % 2 else peak)
    noise_db, lapses = random.uniform(1.0, 2.5), random.uniform(0.0, 0.05)
    curve_db = dict(zip(hz, np.maximum(felt, -80.0), strict=True))
    return SimulatedSitter(curve_db, noise_db, lapses if lapse is None else lapse, seed)


def fitted(person: SimulatedSitter) -> tuple[FitSession, NDArray[np.float64], int]:
    """Return a fit, its errors in dB without their mean, and the number of its trials."""
    session, rows = FitSession(person, person.seed), Rows()
    for _ in run(rows, session, person.answer):
        pass
    errors = session.posterior.curve_db[:-1] - [person.curve_db[hz] for hz in HZ[:-1]]
    return session, errors - errors.mean(), len(rows.trials)


def fit(bench: Workbench) -> Section:
    """Fit simulated people who answer honestly, and some who guess."""
    count = bench.effort.sitters
    honest = [fitted(sitter(seed)) for seed in range(count)]
    guessed = [fitted(sitter(seed, RANDOM)) for seed in range(count)]
    rms_db = np.array([np.sqrt(np.mean(errors**2)) for _, errors, _ in honest])
    trials = [count for _, _, count in honest]
    false, true = (
        100.0 * float(np.mean([bool(session.refusal) for session, *_ in each]))
        for each in (honest, guessed)
    )
    rows = (
        Row("error, median", float(np.median(rms_db)), "dB", must=MEDIAN_DB),
        Row("error, 95th percentile", float(np.percentile(rms_db, 95)), "dB", must=MOST_DB),
        Row("error, largest", float(rms_db.max()), "dB"),
        Row("trials, mean", float(np.mean(trials)), ""),
        Row("trials, most", float(max(trials)), "", must=Must("<=", float(PROTOCOL.trials))),
        Row("honest people refused", false, "%", must=FALSELY),
        Row("guessing people refused", true, "%", must=REFUSED),
    )
    return Section(
        TITLE,
        f"`cushion fit` asks {count} simulated people with known sensitivity, and {count} who "
        "guess. A sensitivity is a smooth random curve of up to ±15 dB plus the resonance of a rig "
        "with a Q of 2 to 8. Decision noise is 1 to 2.5 dB, and up to 5 % of the answers are "
        "guessed. The *error* is the r.m.s. error at the eight test frequencies, without its mean "
        "and before the gain is cut.",
        rows,
    )
