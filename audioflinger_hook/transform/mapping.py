"""Audio frequency to vibration frequency: equation (4), or with equal JNDs an octave.

Equation (4) gives every octave of sound the same span in Hz, 25 Hz with the defaults. What can be
told apart grows with the frequency itself: the just noticeable difference of whole-body vibration
rises linearly from 5 to 40 Hz (Bellmann, 2002), and over 20 to 90 Hz it is a third of the
frequency and more (Merchel, Altinsoy and Stamm, Internoise 2011). Under equation (4) the lowest
octave of sound is felt over more than an octave, the highest over an eighth of its frequency, less
than one JND. `jnd` gives every octave of sound the same ratio instead, 1.34 with the defaults.

How strong each principal frequency vibrates: the level laws.

A steady tone of amplitude A has r = A R, where R = 1.30 fs/N is the r of a full-scale one, and
comes out with A under either law. They differ in what is not one tone.
"""

from __future__ import annotations

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.parameters import TransformParameters


def vibration_hz(audio_hz: FloatArray, parameters: TransformParameters) -> FloatArray:
    """Return the vibration frequencies s(x), in Hz.

    audio_hz: any shape, above 0. `paper`: s(x) = B_c ln(x / f_m) + F_b; `jnd`: s(x) =
    F_b (x / f_m)^c, with c such that the band's ends are the same. With the defaults either makes
    21.54 Hz of 50 Hz and 220 Hz of 12 kHz; of 1 kHz they make 130 and 77 Hz.
    """
    octaves = np.log(audio_hz / parameters.band_low_hz)
    if parameters.mapping == "jnd":
        geometric: FloatArray = parameters.vibration_bottom_hz * np.exp(
            parameters.scale_ratio * octaves
        )
        return geometric
    return parameters.scale_hz * octaves + parameters.vibration_bottom_hz


def heard_hz(felt_hz: float, parameters: TransformParameters) -> float:
    """Return the audio frequency in Hz that is felt at a vibration frequency in Hz."""
    low_hz, bottom_hz = parameters.band_low_hz, parameters.vibration_bottom_hz
    if parameters.mapping == "jnd":
        return low_hz * float(np.exp(np.log(felt_hz / bottom_hz) / parameters.scale_ratio))
    return low_hz * float(np.exp((felt_hz - bottom_hz) / parameters.scale_hz))


def slope(parameters: TransformParameters) -> tuple[float, float]:
    """Return a and b of ds/d(ln x) = a + b s, Hz of vibration for each factor e of audio."""
    if parameters.mapping == "jnd":
        return 0.0, parameters.scale_ratio
    return parameters.scale_hz, 0.0


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
