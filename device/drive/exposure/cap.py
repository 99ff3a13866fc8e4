"""The optional cap: a gain that lets a day's limit be approached, but not passed."""

import math

from device.drive.exposure.dose import Exposure

_FREE = 0.5
"""Share of what a limit allows that is used up before anything changes: 71 % of the A(8) limit."""


def cap_gain(exposure: Exposure, a8_m_s2: float, vdv: float) -> float:
    """The gain, 0 to 1, for what is to come, from what has been so far today.

    a8_m_s2, vdv: limits of A(8) and VDV, above 0. A dose grows with the second power of the gain
    (VDV: the fourth). Beyond half of what is allowed, that power is what is left over half of it.
    So the rest is used up ever more slowly: with the level that there is, it falls by e each time
    half of the allowed dose would have been added, and never comes to an end. Nothing is turned
    down suddenly. What is added between two calls must be small beside that half: ask as often as
    the meter looks. Pure; any thread may call it.
    """
    by_a8 = math.sqrt(_left((exposure.a8_m_s2 / a8_m_s2) ** 2))
    by_vdv = math.sqrt(math.sqrt(_left((exposure.vdv / vdv) ** 4)))
    return min(by_a8, by_vdv)


def _left(used: float) -> float:
    """1 up to the free share, then falling to 0 where all is used."""
    return min(1.0, max(0.0, (1.0 - used) / (1.0 - _FREE)))
