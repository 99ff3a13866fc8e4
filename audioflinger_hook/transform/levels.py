"""How strong each principal frequency vibrates: the level laws.

A steady tone of amplitude A has r = A R, where R = 1.30 fs/N is the r of a full-scale one, and
comes out with A under either law. They differ in what is not one tone.
"""

from __future__ import annotations

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.parameters import TransformParameters


def law_amplitudes(
    amplitude: FloatArray, r: FloatArray, full_scale_r: float, parameters: TransformParameters
) -> FloatArray:
    """Return the amplitudes of one window's principal frequencies, (partials,), full scale 1.

    amplitude: their heights A; r: A times half-power bandwidth df, Hz; full_scale_r: R. Not
    limited.

    `tonal`: P_k r_k / R with P_k = r_k / sum r, equation (6): each has its share of the sum, so
    what is made of many is weak. `energy`: sqrt(A_k r_k / R), so that the power a_k^2 is A_k^2
    times df over the width of a tone: what a spectral peak of that height and width holds. A
    single full-scale sample, whose spectrum is flat, comes out 25 dB weaker.
    """
    if parameters.level_law == "energy":
        strength: FloatArray = np.sqrt(amplitude * r / full_scale_r)
    else:
        strength = r * r / (r.sum() * full_scale_r)
    return strength


def left_by_law(
    amplitude: FloatArray, r: FloatArray, full_scale_r: float, parameters: TransformParameters
) -> float:
    """Return what the law leaves of the level of one window's frequencies, as if of one tone.

    Parameters as of `law_amplitudes`. The root of the sum of squares of what the law gives, over
    that by energy: 1 for a steady tone, 1 / M for M equal ones by `tonal`, always 1 by `energy`.
    A window that is full in part only of what it shows says the same.
    """
    if parameters.level_law == "energy" or not r.size:
        return 1.0
    strength = law_amplitudes(amplitude, r, full_scale_r, parameters)
    energy = float((amplitude * r).sum()) / full_scale_r
    return float(np.sqrt(float((strength * strength).sum()) / energy))
