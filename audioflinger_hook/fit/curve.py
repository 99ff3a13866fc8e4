"""The posterior of a person's sensitivity curve, and the trial that tells most about it.

The curve is the sensitivity in dB relative to 70 Hz. Its prior is the sensitivity that
`strength = "felt"` uses, plus a smooth Gaussian process over log frequency, plus the response of a
rig with one resonance. Frequency and Q of the resonance, and the decision noise, are unknown: each
combination is one hypothesis with its own Gaussian posterior. An answer updates all hypotheses by
moment matching (assumed-density filtering), which is exact for one trial.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, softmax

from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design.strength import felt_weight

Floats = NDArray[np.float64]

REFERENCE_HZ = 70.0
TEST_HZ: Floats = np.round(np.geomspace(25.0, 200.0, 8), 1)
HZ = np.append(TEST_HZ, REFERENCE_HZ)  # of all curves here

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


def resonance_db(hz: Floats, resonance_hz: float, q: float) -> Floats:
    """Return a rig's acceleration per volt at frequencies in Hz, 0 dB far above the resonance."""
    ratio = resonance_hz / hz
    return np.asarray(-20.0 * np.log10(np.hypot(1.0 - ratio**2, ratio / q)))


class CurvePosterior:
    """What the answers so far say about a person's curve. All levels are in dB.

    evidence: log of the answers' probability, relative to guessing. catch_evidence: the same for
    the catch trials alone, which compare the reference with itself.
    """

    def __init__(self) -> None:
        octaves = np.log2(HZ / REFERENCE_HZ)
        apart = (octaves[:, None] - octaves) / SMOOTH_OCTAVES
        covariance = SMOOTH_DB**2 * np.exp(-0.5 * apart**2) + ROUGH_DB**2 * np.eye(HZ.size)
        covariance += TILT_DB**2 * np.outer(octaves, octaves)
        body = FELT_SHARE * 20.0 * np.log10(felt_weight(TransformParameters(strength="felt"), HZ))
        rigs = [resonance_db(HZ, peak_hz, q) for peak_hz in RESONANCES_HZ for q in RESONANCE_QS]
        means = np.array([body, *(body + rig for rig in rigs)])
        shares = np.append(SMOOTH_SHARE, np.full(len(rigs), (1.0 - SMOOTH_SHARE) / len(rigs)))
        relative = np.eye(HZ.size) - (HZ == REFERENCE_HZ)
        self._means = np.repeat(means @ relative.T, NOISES_DB.size, axis=0)
        self._log_shares = np.log(np.repeat(shares / NOISES_DB.size, NOISES_DB.size))
        self._noises = np.tile(NOISES_DB, len(means))
        self._covariances = np.repeat([relative @ covariance @ relative.T], len(self._means), 0)
        self.evidence = self.catch_evidence = 0.0

    @property
    def curve_db(self) -> Floats:
        """Expected sensitivity at HZ, relative to REFERENCE_HZ."""
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

    def add(self, hz: float, level_db: float, stronger: float) -> None:
        """Take an answer.

        hz: of the test, one of HZ. level_db: its level relative to the reference. stronger: 1 if
        the test was stronger, 0 if the reference was; between them, both count with their share.
        """
        index = int(np.argmin(np.abs(HZ - hz)))
        above = level_db + self._means[:, index]
        column = self._covariances[:, :, index].copy()
        chance, density, slope = _chances(above, column[:, index], self._noises)
        yes, no = stronger / chance, (1.0 - stronger) / (1.0 - chance)
        logs = stronger * np.log(chance) + (1.0 - stronger) * np.log1p(-chance)
        evidence = float(np.log(2.0 * (self._shares @ np.exp(logs))))
        self.evidence += evidence
        self.catch_evidence += evidence if hz == REFERENCE_HZ else 0.0
        self._log_shares += logs
        first = density * (yes - no)  # derivatives of `logs` by the mean
        second = slope * (yes - no) - density**2 * (yes / chance + no / (1.0 - chance))
        self._means += column * first[:, None]
        self._covariances += column[:, :, None] * column[:, None, :] * second[:, None, None]

    def next_trial(self, most_db: float = np.inf) -> tuple[float, float]:
        """Return the frequency in Hz and the level, in dB relative to the reference, to try next.

        After this trial, the curve's variance is expected to be lowest. most_db: highest level that
        can be played.
        """
        counts = self._shares > NEGLIGIBLE
        shares = self._shares[counts] / self._shares[counts].sum()
        tests = slice(TEST_HZ.size)
        means, covariances = self._means[counts, tests], self._covariances[counts, tests, tests]
        levels = np.minimum(np.round(-(shares @ means))[:, None] + OFFSETS_DB, most_db)
        variances = np.einsum("hii->hi", covariances)[:, :, None]
        noises = self._noises[counts, None, None]
        chance, density, _ = _chances(means[:, :, None] + levels, variances, noises)
        moved = np.einsum("h,hix,hji->ixj", shares, density, covariances, optimize=True)
        # The expected square of the mean grows by as much as the expected variance falls.
        squares = np.zeros(levels.shape)
        for sign, answer in ((1.0, chance), (-1.0, 1.0 - chance)):
            total = np.einsum("h,hix,hj->ixj", shares, answer, means, optimize=True) + sign * moved
            squares += (total**2).sum(axis=2) / np.einsum("h,hix->ix", shares, answer)
        index, place = np.unravel_index(int(np.argmax(squares)), squares.shape)
        return float(TEST_HZ[index]), float(levels[index, place])


def _chances(above: Floats, variance: Floats, noises: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the chance that a difference is felt, and its first and second derivative."""
    spread = np.sqrt(noises**2 + variance)
    z = above / spread
    density = (1.0 - LAPSES) * np.exp(-0.5 * z**2) / (np.sqrt(2.0 * np.pi) * spread)
    return 0.5 * LAPSES + (1.0 - LAPSES) * ndtr(z), density, -z / spread * density
