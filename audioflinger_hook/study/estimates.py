"""Estimates of a study's parameters, with 95 % intervals, and tests that nothing differs.

Each estimate is a function of a mean over participants, and SciPy's bootstrap draws participants.
Its percentiles are Hesterberg's expanded ones (American Statistician 69, 2015), because plain ones
are too narrow for few participants. The bootstrap's bias is subtracted from the estimate.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from device.units import FloatArray

RESAMPLES, LEVEL = 2_000, 0.95


@dataclass(frozen=True)
class Measured:
    """What a question has measured.

    names: of the estimates. features: of each participant, (people, ...). statistic: computes
    estimates (draws, names) from means of features (draws, ...). scores: (people, tests), of mean 0
    if nothing differs. tests: names of the tests. low, high: bounds of the estimates.
    """

    names: Sequence[str]
    features: FloatArray
    scores: FloatArray
    tests: Sequence[str]
    statistic: Callable[[FloatArray], FloatArray] = lambda mean: mean
    low: float = -np.inf
    high: float = np.inf


def estimate(measured: Measured, seed: int) -> FloatArray:
    """Return values, and lower and upper ends of the intervals, (3, names). seed: of the bootstrap.

    The intervals of one participant are NaN.
    """
    n = len(measured.features)

    def statistic(drawn: NDArray[np.intp], axis: int = -1) -> FloatArray:
        counts = np.stack([np.bincount(one, minlength=n) for one in np.atleast_2d(drawn)])
        return measured.statistic(np.tensordot(counts / n, measured.features, 1)).T

    values = statistic(np.arange(n))[:, 0]
    lows, highs = np.full((2, len(values)), np.nan)
    if n > 1:
        tail = stats.norm.cdf(np.sqrt(n / (n - 1)) * stats.t.ppf(0.5 - 0.5 * LEVEL, n - 1))
        drawn = stats.bootstrap(
            (np.arange(n),), statistic, n_resamples=RESAMPLES, vectorized=True,
            confidence_level=1.0 - 2.0 * tail, method="percentile", random_state=seed,
        )  # fmt: skip
        lows, highs = drawn.confidence_interval
        values = 2.0 * values - drawn.bootstrap_distribution.mean(axis=-1)
    return np.asarray(np.clip((values, lows, highs), measured.low, measured.high))


def p_values(measured: Measured) -> tuple[float | None, dict[str, float]]:
    """Return p of Hotelling's test that all means are 0, and p of each t test after Holm.

    Without tests, or with too few participants, return None and nothing.
    """
    n, d = measured.scores.shape
    if d == 0 or n <= d + 1:
        return None, {}
    mean, cov = measured.scores.mean(axis=0), np.cov(measured.scores, rowvar=False).reshape(d, d)
    cov += 1e-9 * np.eye(d)  # all participants may agree
    f = n * float(mean @ np.linalg.solve(cov, mean)) * (n - d) / (d * (n - 1))
    single = 2.0 * stats.t.sf(np.abs(mean) / np.sqrt(np.diag(cov) / n), n - 1)
    order = np.argsort(single)
    holm = np.minimum(1.0, np.maximum.accumulate(single[order] * (d - np.arange(d))))
    names = [measured.tests[i] for i in order]
    return float(stats.f.sf(f, d, n - d)), dict(zip(names, holm.tolist(), strict=True))
