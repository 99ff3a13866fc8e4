"""The sensitivity to vibration of each frequency, by which `strength` weights amplitudes."""

import math

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.parameters import TransformParameters, fit_points
from device.errors import UsageError

FELT_AT_HZ = 40.0
"""Vibration of this frequency has weight 1.

Above 12.5 Hz, the sensitivity of a seated body to vertical acceleration is proportional to 1/f.
Sources: W_k of ISO 2631-1, up to 100 Hz; Griffin, Whitham and Parsons, Ergonomics 25, 1982."""

FIT_BOOST_DB = 12.0  # largest gain of strength "fit" relative to 70 Hz
FELT_FROM_HZ = 30.0  # lower vibration has the weight of this frequency
RIG_LEAST = 1.0 / 16.0  # smallest product of the gains of damping and of the actuator


def felt_weight(parameters: TransformParameters, vibration_hz: FloatArray) -> FloatArray:
    """Return the sensitivity of a seated body to vibration at frequencies in Hz.

    With strength "flat", the sensitivity is 1. With "felt", it is the sensitivity to acceleration,
    relative to that at 40 Hz. With "rig" and a resonance_hz above 0, it is also multiplied by the
    gain of damping and the actuator's relative acceleration per volt, 1 far above resonance. With
    "fit", it is the curve `fit` relative to 70 Hz, interpolated in dB over log frequency, and not
    below -FIT_BOOST_DB. UsageError: the strength is "fit", and `fit` is not a curve.
    """
    if parameters.strength == "flat":
        return np.ones_like(vibration_hz)
    if parameters.strength == "fit":
        if ":" not in parameters.fit:
            raise UsageError(f"fit={parameters.fit!r} is not a curve; read it with Settings.fitted")
        fit_hz, sensitivity_db = np.array(fit_points(parameters.fit)).T
        octaves = np.log2(np.maximum(vibration_hz, fit_hz[0]))
        level_db = np.interp(octaves, np.log2(fit_hz), sensitivity_db)
        return np.asarray(10.0 ** (np.maximum(level_db, -FIT_BOOST_DB) / 20.0))
    hz = np.maximum(vibration_hz, FELT_FROM_HZ)
    felt: FloatArray = FELT_AT_HZ / hz
    if parameters.strength == "rig" and parameters.resonance_hz > 0.0:
        ratio = parameters.resonance_hz / hz
        response = 1.0 / np.hypot(1.0 - ratio**2, ratio / parameters.resonance_q)
        gain = math.pow(10.0, parameters.resonance_gain_db / 20.0)
        felt *= np.maximum(gain * response, RIG_LEAST)
    return felt
