"""The posterior of a person's sensitivity curve, and the most informative next trial.

The curve is the sensitivity in dB relative to 70 Hz. Its prior is the sensitivity that
`strength = "felt"` uses, plus a smooth Gaussian process over log frequency, plus the response of a
rig with one resonance. Frequency and Q of the resonance, and the decision noise, are unknown: each
combination is one hypothesis with its own Gaussian posterior. An answer updates all hypotheses by
moment matching (assumed-density filtering), which is exact for one trial.
"""

import numpy as np
from scipy.special import ndtr, softmax

from audioflinger_hook.fit import PROTOCOL as P
from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design.strength import felt_weight
from device.units import FloatArray

HZ = np.array([*P.test_hz, P.reference_hz])


def resonance_db(hz: FloatArray, resonance_hz: float, q: float) -> FloatArray:
    """Return a rig's acceleration per volt at frequencies in Hz, 0 dB far above the resonance."""
    ratio = resonance_hz / hz
    return np.asarray(-20.0 * np.log10(np.hypot(1.0 - ratio**2, ratio / q)))


class CurvePosterior:
    """What the answers so far say about a person's curve. All levels are in dB.

    curve_db: expected sensitivity at HZ, relative to the reference. uncertainty_db: its standard
    deviation. jnd_db: expected standard deviation of the decision noise. evidence: log of the
    answers' probability, relative to guessing. catch_evidence: the same for the catch trials alone,
    which compare the reference with itself.
    """

    def __init__(self) -> None:
        octaves = np.log2(HZ / P.reference_hz)
        apart = (octaves[:, None] - octaves) / P.smooth_octaves
        covariance = P.smooth_db**2 * np.exp(-0.5 * apart**2) + P.rough_db**2 * np.eye(HZ.size)
        covariance += P.tilt_db**2 * np.outer(octaves, octaves)
        body = 20.0 * np.log10(felt_weight(TransformParameters(strength="felt"), HZ))
        resonances_hz = np.geomspace(*P.resonances_hz)
        rigs = [resonance_db(HZ, hz, q) for hz in resonances_hz for q in P.resonance_qs]
        shares = [P.smooth_share, *(len(rigs) * [(1.0 - P.smooth_share) / len(rigs)])]
        relative = np.eye(HZ.size) - (P.reference_hz == HZ)
        means = (P.felt_share * body + [np.zeros(HZ.size), *rigs]) @ relative.T
        self._means = np.repeat(means, len(P.noises_db), axis=0)
        self._log_shares = np.log(np.repeat(shares, len(P.noises_db)))
        self._noises = np.tile(P.noises_db, len(means))
        self._covariances = np.array([relative @ covariance @ relative.T] * len(self._means))
        self.evidence = self.catch_evidence = 0.0
        self._sum_up()

    def _sum_up(self) -> None:
        self._shares = softmax(self._log_shares)
        self.curve_db = self._shares @ self._means
        apart = self._means - self.curve_db
        within = np.tensordot(self._shares, self._covariances, 1)
        self._covariance = within + (self._shares[:, None] * apart).T @ apart
        self.uncertainty_db = np.sqrt(np.diag(self._covariance))
        self.jnd_db = float(self._shares @ self._noises)

    def add(self, hz: float, level_db: float, stronger: float) -> None:
        """Take an answer.

        hz: of the test, one of HZ. level_db: its level relative to the reference. stronger: 1 if
        the test was stronger, 0 if the reference was; between them, both count with their share.
        """
        index = int(np.argmin(np.abs(HZ - hz)))
        column = self._covariances[:, :, index].copy()
        spread = np.sqrt(self._noises**2 + column[:, index])
        z = (level_db + self._means[:, index]) / spread
        chance = 0.5 * P.lapses + (1.0 - P.lapses) * ndtr(z)
        density = (1.0 - P.lapses) * np.exp(-0.5 * z**2) / (np.sqrt(2.0 * np.pi) * spread)
        yes, no = stronger / chance, (1.0 - stronger) / (1.0 - chance)
        logs = stronger * np.log(chance) + (1.0 - stronger) * np.log1p(-chance)
        evidence = float(np.log(2.0 * (self._shares @ np.exp(logs))))
        self.evidence += evidence
        self.catch_evidence += evidence if hz == P.reference_hz else 0.0
        self._log_shares += logs
        first = density * (yes - no)  # derivatives of `logs` by the mean
        second = -z / spread * first - density**2 * (yes / chance + no / (1.0 - chance))
        self._means += column * first[:, None]
        self._covariances += column[:, :, None] * column[:, None, :] * second[:, None, None]
        self._sum_up()

    def next_trial(self) -> tuple[float, float]:
        """Return the frequency in Hz and the level, in dB relative to the reference, to try next.

        Of all trials near equality, it would lower the variance of a Gaussian posterior most.
        """
        gains = (self._covariance**2).sum(axis=0) / (self.jnd_db**2 + self.uncertainty_db**2)
        index = int(np.argmax(gains))
        return float(HZ[index]), -round(float(self.curve_db[index]))
