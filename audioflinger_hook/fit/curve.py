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
TESTS = slice(TEST_HZ.size)

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


def resonance_db(hz: Floats, resonance_hz: float, q: float) -> Floats:
    """Return a rig's acceleration per volt at frequencies in Hz, 0 dB far above the resonance."""
    ratio = resonance_hz / hz
    return np.asarray(-20.0 * np.log10(np.hypot(1.0 - ratio**2, ratio / q)))


class CurvePosterior:
    """What the answers so far say about a person's curve. All levels are in dB.

    curve_db: expected sensitivity at HZ, relative to REFERENCE_HZ. uncertainty_db: its standard
    deviation. jnd_db: expected standard deviation of the decision noise. evidence: log of the
    answers' probability, relative to guessing. catch_evidence: the same for the catch trials alone,
    which compare the reference with itself.
    """

    def __init__(self) -> None:
        octaves = np.log2(HZ / REFERENCE_HZ)
        apart = (octaves[:, None] - octaves) / SMOOTH_OCTAVES
        covariance = SMOOTH_DB**2 * np.exp(-0.5 * apart**2) + ROUGH_DB**2 * np.eye(HZ.size)
        covariance += TILT_DB**2 * np.outer(octaves, octaves)
        body = FELT_SHARE * 20.0 * np.log10(felt_weight(TransformParameters(strength="felt"), HZ))
        rigs = [resonance_db(HZ, peak_hz, q) for peak_hz in RESONANCES_HZ for q in RESONANCE_QS]
        shares = [SMOOTH_SHARE, *(len(rigs) * [(1.0 - SMOOTH_SHARE) / len(rigs)])]
        relative = np.eye(HZ.size) - (HZ == REFERENCE_HZ)
        means = np.array([body, *(body + rig for rig in rigs)]) @ relative.T
        self._means = np.repeat(means, NOISES_DB.size, axis=0)
        self._log_shares = np.log(np.repeat(shares, NOISES_DB.size))
        self._noises = np.tile(NOISES_DB, len(means))
        self._covariances = np.array([relative @ covariance @ relative.T] * len(self._means))
        self.evidence = self.catch_evidence = 0.0
        self._sum_up()

    def _sum_up(self) -> None:
        self._shares: Floats = softmax(self._log_shares)
        self._variances: Floats = np.einsum("hii->hi", self._covariances)
        self.curve_db: Floats = self._shares @ self._means
        squares = self._shares @ (self._variances + self._means**2) - self.curve_db**2
        self.uncertainty_db: Floats = np.sqrt(np.maximum(0.0, squares))
        self.jnd_db = float(self._shares @ self._noises)

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
        self._sum_up()

    def next_trial(self, most_db: float = np.inf) -> tuple[float, float]:
        """Return the frequency in Hz and the level, in dB relative to the reference, to try next.

        After this trial, the curve's variance is expected to be lowest. most_db: highest level that
        can be played.
        """
        levels = np.minimum(np.round(-self.curve_db[TESTS])[:, None] + OFFSETS_DB, most_db)
        above = self._means[:, TESTS, None] + levels
        variances, noises = self._variances[:, TESTS, None], self._noises[:, None, None]
        chance, density, _ = _chances(above, variances, noises)
        columns = self._covariances[:, TESTS]
        moved = np.einsum("h,hix,hij->ixj", self._shares, density, columns, optimize=True)
        # The expected square of the mean grows by as much as the expected variance falls.
        squares = np.zeros(levels.shape)
        for sign, answer in ((1.0, chance), (-1.0, 1.0 - chance)):
            weights = self._shares[:, None, None] * answer
            total = np.einsum("hix,hj->ixj", weights, self._means) + sign * moved
            squares += (total**2).sum(axis=2) / weights.sum(axis=0)
        index, place = np.unravel_index(int(np.argmax(squares)), squares.shape)
        return float(TEST_HZ[index]), float(levels[index, place])


def _chances(above: Floats, variance: Floats, noises: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the chance that a difference is felt, and its first and second derivative."""
    spread = np.sqrt(noises**2 + variance)
    z = above / spread
    density = (1.0 - LAPSES) * np.exp(-0.5 * z**2) / (np.sqrt(2.0 * np.pi) * spread)
    return 0.5 * LAPSES + (1.0 - LAPSES) * ndtr(z), density, -z / spread * density
