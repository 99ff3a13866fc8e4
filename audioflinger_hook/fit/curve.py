"""The posterior of a person's sensitivity curve, and the trial that tells most about it.

The curve is the sensitivity in dB relative to 70 Hz, at eight frequencies. Its prior is the
sensitivity that `strength = "felt"` uses, plus a smooth Gaussian process over log frequency, plus
the response of a rig with one resonance. Frequency and Q of the resonance, and the decision noise,
are unknown: each combination is one hypothesis with its own Gaussian posterior. An answer updates
all hypotheses by moment matching (assumed-density filtering), which is exact for one trial.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, softmax

from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design.sensitivity import felt_weight

Floats = NDArray[np.float64]

REFERENCE_HZ = 70.0
TEST_HZ: Floats = np.round(np.geomspace(25.0, 200.0, 8), 1)

SMOOTH_DB, SMOOTH_OCTAVES = 8.0, 0.6  # deviation and correlation length of the smooth process
TILT_DB = 6.0  # deviation of a tilt, dB an octave
ROUGH_DB = 2.5  # deviation of each frequency alone
FELT_SHARE = 0.5  # rigs differ, so the prior's mean has half of the body's slope
RESONANCES_HZ: Floats = np.geomspace(22.0, 210.0, 10)
RESONANCE_QS = (2.0, 4.0, 8.0)
SMOOTH_SHARE = 0.4  # prior probability that the rig has no resonance
NOISES_DB: Floats = np.array([0.7, 1.0, 1.4, 2.0, 2.8, 4.0])  # of decisions, one standard deviation
LAPSES = 0.04  # share of answers that are guessed

OFFSETS_DB: Floats = np.arange(-8.0, 9.0)  # candidate levels, relative to the expected equality
NEGLIGIBLE = 1e-4  # hypotheses of lower probability do not count in the choice of a trial
EQUAL_INFORMATION = 2.0 / np.pi  # information of "don't know" about the difference, times noise^2


def resonance_db(hz: Floats, resonance_hz: float, q: float) -> Floats:
    """Return a rig's acceleration per volt at frequencies in Hz, 0 dB far above the resonance."""
    ratio = resonance_hz / hz
    return np.asarray(-20.0 * np.log10(np.hypot(1.0 - ratio**2, ratio / q)))


def _prior() -> tuple[Floats, Floats, Floats, Floats]:
    """Return the mean, probability and decision noise of each hypothesis, and all's covariance."""
    hz = np.append(TEST_HZ, REFERENCE_HZ)
    octaves = np.log2(hz / REFERENCE_HZ)
    apart = (octaves[:, None] - octaves) / SMOOTH_OCTAVES
    covariance = SMOOTH_DB**2 * np.exp(-0.5 * apart**2) + ROUGH_DB**2 * np.eye(hz.size)
    covariance += TILT_DB**2 * np.outer(octaves, octaves)
    body = FELT_SHARE * 20.0 * np.log10(felt_weight(TransformParameters(strength="felt"), hz))
    rigs = [resonance_db(hz, peak_hz, q) for peak_hz in RESONANCES_HZ for q in RESONANCE_QS]
    means = np.array([body, *(body + rig for rig in rigs)])
    shares = np.append(SMOOTH_SHARE, np.full(len(rigs), (1.0 - SMOOTH_SHARE) / len(rigs)))
    relative = np.hstack((np.eye(TEST_HZ.size), -np.ones((TEST_HZ.size, 1))))
    noises = NOISES_DB.size
    each = np.repeat(means @ relative.T, noises, axis=0), np.repeat(shares / noises, noises)
    return *each, np.tile(NOISES_DB, len(means)), relative @ covariance @ relative.T


class CurvePosterior:
    """What the answers so far say about a person's curve. All levels are in dB.

    evidence: log of the answers' probability, relative to guessing. catch_evidence: the same for
    the catch trials alone.
    """

    def __init__(self) -> None:
        self._means, shares, self._noises, covariance = _prior()
        self._covariances = np.repeat(covariance[None], len(self._means), axis=0)
        self._log_shares = np.log(shares)
        self.evidence = self.catch_evidence = 0.0

    @property
    def curve_db(self) -> Floats:
        """Expected sensitivity at TEST_HZ, relative to REFERENCE_HZ."""
        return np.asarray(self._shares @ self._means)

    @property
    def uncertainty_db(self) -> Floats:
        """Standard deviation of `curve_db`."""
        squares = np.einsum("hii->hi", self._covariances) + self._means**2
        return np.asarray(np.sqrt(np.maximum(0.0, self._shares @ squares - self.curve_db**2)))

    @property
    def jnd_db(self) -> float:
        """Expected standard deviation of the decision noise."""
        return float(self._shares @ self._noises)

    @property
    def _shares(self) -> Floats:
        return np.asarray(softmax(self._log_shares))

    def add(self, index: int | None, level_db: float, stronger: float) -> None:
        """Take an answer.

        index: of the test's frequency in TEST_HZ; None for a catch trial at the reference.
        level_db: level of the test relative to the reference.
        stronger: 1 if the test was stronger, 0 if the reference was, 0.5 for "don't know".
        """
        is_test, i = index is not None, index or 0
        above = level_db + self._means[:, i] * is_test
        variance = self._covariances[:, i, i] * is_test
        sign = 1.0 if stronger >= 0.5 else -1.0
        chance, density, z, spread = _chances(sign * above, variance, self._noises)
        likelihood = np.sqrt(chance * (1.0 - chance)) if stronger == 0.5 else chance
        evidence = float(np.log(2.0 * (self._shares @ likelihood)))
        self.evidence += evidence
        self.catch_evidence += 0.0 if is_test else evidence
        self._log_shares += np.log(likelihood)
        if not is_test:
            return
        if stronger == 0.5:  # a measurement of 0
            gains = 1.0 / (variance + self._noises**2 / EQUAL_INFORMATION)
            first, second = -above * gains, -gains
        else:
            first = sign * density / chance  # derivatives of log chance by the mean
            second = -z / spread * density / chance - first**2
        column = self._covariances[:, :, i].copy()
        self._means += column * first[:, None]
        self._covariances += column[:, :, None] * column[:, None, :] * second[:, None, None]

    def next_trial(self, most_db: float = np.inf) -> tuple[int, float]:
        """Return the index in TEST_HZ and the level, in dB relative to the reference, to try next.

        After this trial, the curve's variance is expected to be lowest.
        most_db: highest level that can be played.
        """
        counts = self._shares > NEGLIGIBLE
        shares, means = self._shares[counts], self._means[counts]
        covariances, noises = self._covariances[counts], self._noises[counts]
        shares /= shares.sum()
        levels = np.minimum(np.round(-(shares @ means))[:, None] + OFFSETS_DB, most_db)
        variances = np.einsum("hii->hi", covariances)[:, :, None]
        above = means[:, :, None] + levels
        chance, density, _, _ = _chances(above, variances, noises[:, None, None])
        moved = np.einsum("h,hix,hji->ixj", shares, density, covariances, optimize=True)
        # The expected square of the mean grows by as much as the expected variance falls.
        squares = np.zeros(levels.shape)
        for sign, answer in ((1.0, chance), (-1.0, 1.0 - chance)):
            total = np.einsum("h,hix,hj->ixj", shares, answer, means, optimize=True) + sign * moved
            squares += (total**2).sum(axis=2) / np.einsum("h,hix->ix", shares, answer)
        index, place = np.unravel_index(int(np.argmax(squares)), squares.shape)
        return int(index), float(levels[index, place])


def _chances(
    above: Floats, variance: Floats, noises: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the chance that a difference is felt, its derivative, and above/spread and spread."""
    spread = np.sqrt(noises**2 + variance)
    z = above / spread
    density = (1.0 - LAPSES) * np.exp(-0.5 * z**2) / (np.sqrt(2.0 * np.pi) * spread)
    return 0.5 * LAPSES + (1.0 - LAPSES) * ndtr(z), density, z, spread


def named_by_hz(values: Floats) -> Mapping[str, float]:
    """Return values at TEST_HZ, rounded to 0.01, with Hz as keys; and 0 at REFERENCE_HZ."""
    points = sorted([*zip(TEST_HZ, values, strict=True), (REFERENCE_HZ, 0.0)])
    return {f"{hz:g}": round(float(value), 2) for hz, value in points}
