"""Audio frequency to vibration frequency: equation (4), logarithmic."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.parameters import TransformParameters


def vibration_hz(audio_hz: FloatArray, parameters: TransformParameters) -> FloatArray:
    """Return the vibration frequencies s(x) = B_c ln(x / f_m) + F_b, in Hz.

    audio_hz: any shape, above 0. With the defaults 50 Hz gives 21.54 Hz and 12 kHz gives 220 Hz.
    """
    return (
        parameters.scale_hz * np.log(audio_hz / parameters.band_low_hz)
        + parameters.vibration_bottom_hz
    )
