"""Daily dose of weighted acceleration: r.m.s., A(8) and VDV, and the gain that caps the dose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import bilinear, butter, lfilter, sosfilt

from device.units import FloatArray

HIGHEST_HZ = 80.0
"""End of the standard's weighting; above it the same formula is an extrapolation."""


_Part = tuple[tuple[float, float, float], tuple[float, float, float], float]


def _w(frequency_hz: float) -> float:
    return math.tau * frequency_hz


def _second(frequency_hz: float, q: float) -> tuple[float, float, float]:
    """1 + s / (Q w) + s^2 / w^2, highest power first."""
    return (1.0 / _w(frequency_hz) ** 2, 1.0 / (q * _w(frequency_hz)), 1.0)


_BAND_Q = math.sqrt(0.5)
PARTS: tuple[_Part, ...] = (
    ((1.0 / _w(0.4) ** 2, 0.0, 0.0), _second(0.4, _BAND_Q), 0.4),
    ((0.0, 0.0, 1.0), _second(100.0, _BAND_Q), 100.0),
    ((0.0, 1.0 / _w(12.5), 1.0), _second(12.5, 0.63), 12.5),
    (
        tuple(c * (2.37 / 3.35) ** 2 for c in _second(2.37, 0.91)),  # type: ignore[assignment]
        _second(3.35, 0.91),
        math.sqrt(2.37 * 3.35),
    ),
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
        b, a = bilinear(numerator, denominator, fs=rate)
        sections.append(np.concatenate([np.pad(b, (0, 3 - len(b))), a]))
    return np.array(sections)


ACTION_A8_M_S2, LIMIT_A8_M_S2 = 0.5, 1.15
ACTION_VDV, LIMIT_VDV = 9.1, 21.0
"""Directive 2002/44/EC, article 3: m/s² over eight hours, and m/s^1.75."""

DAY_S = 8 * 3600.0
RUNNING_S = 1.0
"""Time constant of the running r.m.s. (ISO 2631-1, equation 3)."""

_SILENT = 1e-60
"""Energy below this counts as 0, long before numbers become denormal and slow."""

_FREE = 0.5
"""Share of the allowed dose after which the cap begins to act: 71 % of the A(8) limit."""


@dataclass(frozen=True)
class Exposure:
    """Readings of the weighted acceleration so far, each of the channel where it is largest.

    Attributes
    ----------
    time_s : float
        Duration.
    running_m_s2 : float
        R.m.s. of about the last second.
    rms_m_s2 : float
        R.m.s. of all the time.
    a8_m_s2 : float
        A(8): the same energy spread over eight hours.
    vdv : float
        Vibration dose value in m/s^1.75.
    extrapolated : float
        Share of the weighted energy above 80 Hz, where ISO 2631-1 gives no weighting; of the
        channel with the largest A(8).
    """

    time_s: float
    running_m_s2: float
    rms_m_s2: float
    a8_m_s2: float
    vdv: float
    extrapolated: float

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


class Dose:
    """Accumulates weighted acceleration. One thread calls `add`; any may call `exposure`.

    samplerate: rate in Hz.
    channels: number of channels, each with a dose.
    """

    def __init__(self, samplerate: float, channels: int) -> None:
        self._period_s = 1.0 / samplerate
        self._channels = channels
        self._above = butter(4, HIGHEST_HZ, "highpass", fs=samplerate, output="sos")
        share = -math.expm1(-self._period_s / RUNNING_S)
        self._running = [share], [1.0, share - 1.0]
        self.reset()

    def reset(self) -> None:
        """Begin a new day."""
        channels = self._channels
        self._frames = 0
        self._squares, self._fourths, self._high = (np.zeros(channels) for _ in range(3))
        self._now = np.zeros(channels)
        self._past = np.zeros((1, channels))
        self._above_past = np.zeros((len(self._above), 2, channels))

    def add(self, weighted_m_s2: FloatArray) -> None:
        """Add (frames, channels), finite. The lengths of blocks only change the rounding."""
        if not len(weighted_m_s2):
            return
        squares = weighted_m_s2**2
        high, self._above_past = sosfilt(self._above, weighted_m_s2, axis=0, zi=self._above_past)
        running, self._past = lfilter(*self._running, squares, axis=0, zi=self._past)
        if np.abs(self._above_past).max() ** 2 < _SILENT:
            self._above_past[:] = 0.0
        self._past[self._past < _SILENT] = 0.0
        self._frames += len(weighted_m_s2)
        self._squares = self._squares + squares.sum(axis=0)
        self._fourths = self._fourths + (squares**2).sum(axis=0)
        self._high = self._high + (high**2).sum(axis=0)
        self._now = running[-1]

    def exposure(self) -> Exposure:
        """Return the readings, each of the channel where it is largest."""
        worst = int(self._squares.argmax())
        squares = float(self._squares[worst])
        time_s = self._frames * self._period_s
        energy = squares * self._period_s
        return Exposure(
            time_s=time_s,
            running_m_s2=math.sqrt(max(0.0, float(self._now.max()))),
            rms_m_s2=math.sqrt(energy / time_s) if time_s else 0.0,
            a8_m_s2=math.sqrt(energy / DAY_S),
            # One hard knock may give another channel the largest VDV.
            vdv=float(self._fourths.max() * self._period_s) ** 0.25,
            extrapolated=min(1.0, float(self._high[worst]) / squares) if squares else 0.0,
        )


def cap_gain(exposure: Exposure, a8_m_s2: float, vdv: float) -> float:
    """Return the gain, 0 to 1, that lets a day's dose approach its limits but not pass them.

    A dose grows with the second power of the gain (VDV: the fourth). Beyond half of the allowed
    dose, that power is the remaining dose over half of the allowed one. The gain falls slowly and
    the limit is never reached, if little is added between two calls. Any thread may call it.

    Parameters
    ----------
    exposure : Exposure
        The day so far.
    a8_m_s2 : float
        Limit of A(8) in m/s², above 0.
    vdv : float
        Limit of the VDV in m/s^1.75, above 0.
    """
    by_a8 = math.sqrt(_remaining((exposure.a8_m_s2 / a8_m_s2) ** 2))
    by_vdv = math.sqrt(math.sqrt(_remaining((exposure.vdv / vdv) ** 4)))
    return min(by_a8, by_vdv)


def _remaining(used: float) -> float:
    """Return 1 up to the free share of the dose; from there the value falls to 0."""
    return min(1.0, max(0.0, (1.0 - used) / (1.0 - _FREE)))
