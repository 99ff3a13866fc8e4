"""Mains hum in a channel, found in the silence before anything is played."""

import math

import numpy as np

from device.identification.recording import IdentificationError
from device.units import FloatArray

MAINS_HZ = 50.0, 60.0
HARMONICS = 8
MOST_HUM = 0.05
"""Largest r.m.s. of the hum as a share of that during the sweep. Fits leave out its lines; louder
hum hides the marks that compare the clocks."""
_CLEAR = 0.02
"""Smallest share of the silence's power that counts as hum; in white noise it is 0.1 %."""
_MOST = 0.3
"""From this share on, the silence is hum; below, it is noise with some hum."""


def check_hum(silence: FloatArray, loud: float, samplerate: float, name: str) -> float:
    """Return the frequency of the hum in (frames,) of silence that fits must leave out, Hz, or 0.

    IdentificationError: the hum is too large a share of `loud`, the r.m.s. during the sweep.
    """
    time_s = np.arange(len(silence)) / samplerate
    still = silence - silence.mean()
    rms, hz = 0.0, 0.0
    for mains_hz in MAINS_HZ:
        turns = math.tau * mains_hz * np.outer(time_s, np.arange(1, HARMONICS + 1))
        waves = np.concatenate([np.cos(turns), np.sin(turns)], axis=1)
        hum = waves @ np.linalg.lstsq(waves, still)[0]
        rms, hz = max((rms, hz), (float(np.sqrt(np.mean(hum**2))), mains_hz))
    share = rms**2 / max(float(np.mean(still**2)), 1e-300)
    if share > _MOST and rms > MOST_HUM * loud:
        raise IdentificationError(
            f"{name}: mains hum of {hz:g} Hz, {rms:.3g} r.m.s. of full scale, is "
            f"{100 * rms / loud:.2g} % of the signal, at most {100 * MOST_HUM:g} % is allowed; "
            "break the ground loop (a balanced input, a transformer, one socket for all), move "
            "cables away from power supplies, or raise the level"
        )
    return hz if share > _CLEAR else 0.0
