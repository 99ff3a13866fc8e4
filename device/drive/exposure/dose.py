"""Daily dose of weighted acceleration: r.m.s., A(8) and VDV, and the limits of a dose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
import scipy

from device.units import FloatArray

HIGHEST_HZ = 80.0
"""End of the standard's weighting; above it the same formula is an extrapolation."""


def _second(frequency_hz: float, q: float) -> FloatArray:
    """1 + s / (Q w) + s^2 / w^2, highest power first."""
    w = math.tau * frequency_hz
    return np.array([1.0 / w**2, 1.0 / (q * w), 1.0])


_BAND_Q = math.sqrt(0.5)
PARTS: tuple[tuple[FloatArray, FloatArray, float], ...] = (
    (_second(0.4, _BAND_Q) * [1.0, 0.0, 0.0], _second(0.4, _BAND_Q), 0.4),
    (np.array([0.0, 0.0, 1.0]), _second(100.0, _BAND_Q), 100.0),
    (_second(12.5, 1.0) * [0.0, 1.0, 1.0], _second(12.5, 0.63), 12.5),
    (_second(2.37, 0.91) * (2.37 / 3.35) ** 2, _second(3.35, 0.91), math.sqrt(2.37 * 3.35)),
)
"""Numerator, denominator (powers of s, highest first) and the frequency that stays exact."""


def wk_sections(samplerate: float) -> FloatArray:
    """Return Wk as second-order sections for `scipy.signal.sosfilt`, (4, 6), in float64.

    samplerate: Hz, 2000 or more. The bilinear transform is pre-warped, so that each part is exact
    at its frequency. Lower precision, or one polynomial, would lose poles as close to 1 as those of
    0.4 Hz.
    """
    sections = []
    for numerator, denominator, exact_hz in PARTS:
        # s / tan(...) instead of s T / 2: the bilinear transform at this rate, exact at exact_hz.
        rate = math.pi * exact_hz / math.tan(math.pi * exact_hz / samplerate)
        b, a = scipy.signal.bilinear(numerator, denominator, fs=rate)
        sections.append(np.concatenate([np.pad(b, (0, 3 - len(b))), a]))
    return np.array(sections)


ACTION_A8_M_S2, LIMIT_A8_M_S2 = 0.5, 1.15
ACTION_VDV, LIMIT_VDV = 9.1, 21.0
"""Directive 2002/44/EC, article 3: m/s² over eight hours, and m/s^1.75."""

DAY_S = 8 * 3600.0
RUNNING_S = 1.0
"""Time constant of the running r.m.s. (ISO 2631-1, equation 3)."""

CAPS: dict[str, tuple[float, float] | None] = {
    "off": None,
    "action": (ACTION_A8_M_S2, ACTION_VDV),
    "limit": (LIMIT_A8_M_S2, LIMIT_VDV),
}
"""Limits of each exposure cap, from 2002/44/EC: A(8) in m/s² and VDV in m/s^1.75. The cap begins to
act at half of the dose, 71 % of the A(8) limit."""


@dataclass(frozen=True)
class Exposure:
    """Readings of the weighted acceleration so far, each of the channel where it is largest.

    time_s: duration. running_m_s2, rms_m_s2: r.m.s. of about the last second, and of all the time.
    a8_m_s2: A(8), the same energy spread over eight hours. vdv: vibration dose value in m/s^1.75.
    extrapolated: share of the weighted energy above 80 Hz, where ISO 2631-1 gives no weighting; of
    the channel with the largest A(8).
    """

    time_s: float
    running_m_s2: float
    rms_m_s2: float
    a8_m_s2: float
    vdv: float
    extrapolated: float

    @classmethod
    def of(cls, sums: Sequence[DoseSums], running_m_s2: float = 0.0) -> Exposure:
        """Return the readings of channels with these sums, each of the channel where it is largest.

        sums: one or more. running_m_s2: the largest of all channels.
        """
        worst = max(sums, key=lambda one: one.squares)
        return cls(
            time_s=worst.time_s,
            running_m_s2=running_m_s2,
            rms_m_s2=math.sqrt(worst.squares / worst.time_s) if worst.time_s else 0.0,
            a8_m_s2=math.sqrt(worst.squares / DAY_S),
            # One hard knock may give another channel the largest VDV.
            vdv=max(one.fourths for one in sums) ** 0.25,
            extrapolated=min(1.0, worst.high / worst.squares) if worst.squares else 0.0,
        )

    @property
    def above_action(self) -> bool:
        """Whether an action value of 2002/44/EC is reached: 0.5 m/s² A(8), or 9.1 VDV."""
        return self.a8_m_s2 >= ACTION_A8_M_S2 or self.vdv >= ACTION_VDV

    @property
    def above_limit(self) -> bool:
        """Whether a limit value of 2002/44/EC is reached: 1.15 m/s² A(8), or 21 VDV."""
        return self.a8_m_s2 >= LIMIT_A8_M_S2 or self.vdv >= LIMIT_VDV

    def __str__(self) -> str:
        """One line for display."""
        return (
            f"A(8) {self.a8_m_s2:.3g} m/s² (action {ACTION_A8_M_S2:g}, limit {LIMIT_A8_M_S2:g}), "
            f"VDV {self.vdv:.3g} m/s^1.75 (action {ACTION_VDV:g}, limit {LIMIT_VDV:g}); "
            f"{100.0 * self.extrapolated:.0f} % of it above {HIGHEST_HZ:g} Hz, extrapolated"
        )


@dataclass(frozen=True)
class DoseSums:
    """Weighted acceleration of a day so far, integrated over time.

    time_s: duration. squares, fourths: in m²/s³ and m⁴/s⁷. high: the squares' part above 80 Hz.
    """

    time_s: float = 0.0
    squares: float = 0.0
    fourths: float = 0.0
    high: float = 0.0

    def plus(self, other: DoseSums, times: float = 1.0) -> DoseSums:
        """Return the sum of this dose and a multiple of another."""
        pairs = zip(astuple(self), astuple(other), strict=True)
        return DoseSums(*(mine + times * theirs for mine, theirs in pairs))

    def at_least(self, other: DoseSums) -> DoseSums:
        """Return the larger of each."""
        return DoseSums(*map(max, astuple(self), astuple(other)))
